//! What a cloud without normals tells: planes of its patches, and its inside.

use numpy::{IntoPyArray, PyArray1, PyArray2, PyReadonlyArray2, PyUntypedArrayMethods};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use tspline_kernels::patch;
use tspline_kernels::sides;
use tspline_kernels::walk;

use crate::convert::{points, run, table, values, Points, Values};

type Planes<'py> = (
    Bound<'py, PyArray2<f64>>,
    Bound<'py, PyArray2<f64>>,
    Bound<'py, PyArray2<f64>>,
);
type Sides<'py> = (
    Bound<'py, PyArray1<f64>>,
    Bound<'py, PyArray1<f64>>,
    Bound<'py, PyArray2<f64>>,
    Bound<'py, PyArray1<f64>>,
);

/// Number of threads that the kernels use.
#[pyfunction]
pub fn num_threads() -> usize {
    tspline_kernels::num_threads()
}

/// Centres, unit normals of either sign, and ascending variances of the patches' planes.
#[pyfunction]
pub fn planes<'py>(
    py: Python<'py>,
    cloud: Points<'_>,
    queries: Points<'_>,
    patches: PyReadonlyArray2<'_, i64>,
) -> PyResult<Planes<'py>> {
    let cloud = points::<3>(&cloud, "points")?;
    let queries = points::<3>(&queries, "queries")?;
    let width = patches.as_array().ncols();
    let flat = patches
        .as_slice()
        .ok()
        .filter(|_| patches.is_c_contiguous())
        .ok_or_else(|| PyValueError::new_err("patches must be C-contiguous"))?;
    if width == 0 || flat.len() != width * queries.len() {
        return Err(PyValueError::new_err("patches must have a row for each query"));
    }
    let rows: Vec<&[i64]> = flat.chunks_exact(width).collect();
    let planes = run(py, || patch::planes(cloud, queries, &rows))?;
    let part = |of: fn(&patch::Plane) -> [f64; 3]| table(py, planes.iter().map(of).collect());
    Ok((part(|p| p.center)?, part(|p| p.normal)?, part(|p| p.variance)?))
}

/// Sides of the Delaunay cells and signs of the normals in [-1, 1], centres and radii of the cells' balls.
#[pyfunction]
#[pyo3(signature = (cloud, normals, trust, reach, cells, neighbours))]
pub fn sides_of<'py>(
    py: Python<'py>,
    cloud: Points<'_>,
    normals: Points<'_>,
    trust: Values<'_>,
    reach: Values<'_>,
    cells: PyReadonlyArray2<'_, i32>,
    neighbours: PyReadonlyArray2<'_, i32>,
) -> PyResult<Sides<'py>> {
    let given = sides::Samples {
        points: points::<3>(&cloud, "points")?,
        normals: points::<3>(&normals, "normals")?,
        trust: values(&trust, "trust")?,
        reach: values(&reach, "reach")?,
    };
    let count = given.points.len();
    if given.normals.len() != count || given.trust.len() != count || given.reach.len() != count {
        return Err(PyValueError::new_err(
            "normals, trust and reach must have one entry a point",
        ));
    }
    let (cells, neighbours) = (four(&cells, "cells")?, four(&neighbours, "neighbours")?);
    let found = run(py, || sides::sides(given, &cells, &neighbours))?;
    Ok((
        found.cells.into_pyarray(py),
        found.samples.into_pyarray(py),
        table(py, found.centers)?,
        found.radii.into_pyarray(py),
    ))
}

/// The Delaunay cell that holds each query, -1 outside of the hull.
#[pyfunction]
pub fn locate_cells<'py>(
    py: Python<'py>,
    cloud: Points<'_>,
    cells: PyReadonlyArray2<'_, i32>,
    neighbours: PyReadonlyArray2<'_, i32>,
    queries: Points<'_>,
) -> PyResult<Bound<'py, PyArray1<i32>>> {
    let cloud = points::<3>(&cloud, "points")?;
    let queries = points::<3>(&queries, "queries")?;
    let (cells, neighbours) = (four(&cells, "cells")?, four(&neighbours, "neighbours")?);
    Ok(run(py, || walk::locate(cloud, &cells, &neighbours, queries))?.into_pyarray(py))
}

fn four(array: &PyReadonlyArray2<'_, i32>, name: &str) -> PyResult<Vec<[i32; 4]>> {
    let rows = array.as_array();
    if rows.ncols() != 4 {
        return Err(PyValueError::new_err(format!("{name} must have 4 columns")));
    }
    Ok(rows
        .rows()
        .into_iter()
        .map(|r| std::array::from_fn(|a| r[a]))
        .collect())
}
