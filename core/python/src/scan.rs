//! Signed distances to triangle meshes on the nodes of grids.

use numpy::{PyReadonlyArray2, PyUntypedArrayMethods};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use tspline_kernels::grid::scan;
use tspline_kernels::grid::Nodes;

use crate::blocks::Blocks;
use crate::convert::{points, run, Points};

/// Distances of nodes `origin + spacing * index` within `far` of a closed, outward triangle mesh, < 0 inside.
#[pyfunction]
#[pyo3(signature = (vertices, faces, shape, origin, spacing, far))]
pub fn scan_convert(
    py: Python<'_>,
    vertices: Points<'_>,
    faces: PyReadonlyArray2<'_, u32>,
    shape: [usize; 3],
    origin: [f64; 3],
    spacing: [f64; 3],
    far: f64,
) -> PyResult<Blocks> {
    let vertices = points::<3>(&vertices, "vertices")?;
    let flat = faces
        .as_slice()
        .ok()
        .filter(|_| faces.is_c_contiguous() && faces.shape()[1] == 3)
        .ok_or_else(|| PyValueError::new_err("faces must be C-contiguous with 3 columns"))?;
    let faces: &[[u32; 3]] = bytemuck::cast_slice(flat);
    let kernel = run(py, || {
        let nodes = Nodes::new(shape, origin, spacing)?;
        scan::scan_convert(vertices, faces, &nodes, far)
    })?;
    Ok(kernel.into())
}
