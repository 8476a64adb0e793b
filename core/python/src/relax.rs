//! Labelling by convex relaxation.

use numpy::{IntoPyArray, PyArrayDyn, PyArrayMethods, PyReadonlyArrayDyn, PyUntypedArrayMethods};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use tspline_kernels::relax::Relaxation;

use crate::convert::{dimension, run};

type Image<'py> = PyReadonlyArrayDyn<'py, f32>;

/// Steps between looks for Ctrl-C.
const STEPS: usize = 50;

fn flat<'a>(image: &'a Image<'_>, shape: &[usize], name: &str) -> PyResult<&'a [f32]> {
    image
        .as_slice()
        .ok()
        .filter(|_| image.is_c_contiguous() && image.shape() == shape)
        .ok_or_else(|| PyValueError::new_err(format!("{name} must be C-contiguous, of shape {shape:?}")))
}

fn relaxed<const D: usize>(
    py: Python<'_>,
    evidence: &[f32],
    edges: &[f32],
    shape: &[usize],
    spacing: &[f64],
    start: Option<&[f32]>,
    max_steps: usize,
    tolerance: f64,
) -> PyResult<(Vec<f32>, usize, f64)> {
    let shape: [usize; D] = shape.try_into().expect("the caller looked");
    let spacing: [f64; D] = spacing.try_into().map_err(|_| {
        PyValueError::new_err(format!("spacing must have {D} lengths, found {}", spacing.len()))
    })?;
    let mut relaxation = run(py, || {
        Relaxation::new(evidence, edges, shape, spacing, start, max_steps, tolerance)
    })?;
    while !run(py, || Ok(relaxation.advance(STEPS)))? {}
    Ok(relaxation.finish())
}

/// u in [0, 1] that minimises sum edges |grad u| - evidence u; the number of steps, and the duality gap relative to what
/// the better of the two empty labellings could be improved by.
#[pyfunction]
#[pyo3(signature = (evidence, edges, spacing, start=None, max_steps=500, tolerance=3e-4))]
pub fn relaxed_regions<'py>(
    py: Python<'py>,
    evidence: Image<'py>,
    edges: Image<'py>,
    spacing: Vec<f64>,
    start: Option<Image<'py>>,
    max_steps: usize,
    tolerance: f64,
) -> PyResult<(Bound<'py, PyArrayDyn<f32>>, usize, f64)> {
    let shape = evidence.shape().to_vec();
    dimension(shape.len())?;
    let evidence = flat(&evidence, &shape, "evidence")?;
    let edges = flat(&edges, &shape, "edges")?;
    let start = start.as_ref().map(|s| flat(s, &shape, "start")).transpose()?;
    let kernel = if shape.len() == 2 {
        relaxed::<2>
    } else {
        relaxed::<3>
    };
    let (u, steps, gap) = kernel(py, evidence, edges, &shape, &spacing, start, max_steps, tolerance)?;
    Ok((u.into_pyarray(py).reshape(shape)?, steps, gap))
}
