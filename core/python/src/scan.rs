//! Signed distances to triangle meshes on the nodes of grids.

use numpy::{IntoPyArray, PyArray1, PyArray2, PyArrayMethods, PyReadonlyArray2, PyUntypedArrayMethods};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use tspline_kernels::grid::scan;
use tspline_kernels::grid::Nodes;

use crate::convert::{points, run, Points};

type Parts<'py> = (
    Bound<'py, PyArray2<u32>>,
    Bound<'py, PyArray2<f64>>,
    Bound<'py, PyArray1<bool>>,
);

/// Distances of nodes `origin + spacing * index` within `far` of a closed, outward triangle mesh, < 0 inside.
#[pyfunction]
#[pyo3(signature = (vertices, faces, shape, origin, spacing, far))]
pub fn scan_convert<'py>(
    py: Python<'py>,
    vertices: Points<'_>,
    faces: PyReadonlyArray2<'_, u32>,
    shape: [usize; 3],
    origin: [f64; 3],
    spacing: [f64; 3],
    far: f64,
) -> PyResult<Parts<'py>> {
    let vertices = points::<3>(&vertices, "vertices")?;
    let flat = faces
        .as_slice()
        .ok()
        .filter(|_| faces.is_c_contiguous() && faces.shape()[1] == 3)
        .ok_or_else(|| PyValueError::new_err("faces must be C-contiguous with 3 columns"))?;
    let faces: &[[u32; 3]] = bytemuck::cast_slice(flat);
    let blocks = run(py, || {
        let nodes = Nodes::new(shape, origin, spacing)?;
        scan::scan_convert(vertices, faces, &nodes, far)
    })?;
    let places = blocks.places().as_flattened().to_vec();
    let values = blocks.values().to_vec();
    Ok((
        places.into_pyarray(py).reshape([blocks.len(), 3])?,
        values.into_pyarray(py).reshape([blocks.len(), 512])?,
        blocks.inside().into_pyarray(py),
    ))
}
