//! Labelling by convex relaxation.

use numpy::{IntoPyArray, PyArrayDyn, PyArrayMethods, PyReadonlyArrayDyn, PyUntypedArrayMethods};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use tspline_kernels::relax::{Limits, Relaxation};

use crate::convert::{dimension, run};

type Image<'py> = PyReadonlyArrayDyn<'py, f32>;
/// Shares, the number of steps, the relative duality gap.
type Relaxed<'py> = (Bound<'py, PyArrayDyn<f32>>, usize, f64);

/// Steps between looks for Ctrl-C.
const STEPS: usize = 50;

fn flat<'a>(image: &'a Image<'_>, shape: &[usize], name: &str) -> PyResult<&'a [f32]> {
    image
        .as_slice()
        .ok()
        .filter(|_| image.is_c_contiguous() && image.shape() == shape)
        .ok_or_else(|| PyValueError::new_err(format!("{name} must be C-contiguous, of shape {shape:?}")))
}

fn solve<const D: usize>(
    py: Python<'_>,
    evidence: &[f32],
    edges: &[f32],
    shape: &[usize],
    spacing: &[f64],
    start: Option<&[f32]>,
    limits: Limits,
) -> PyResult<(Vec<f32>, usize, f64)> {
    let spacing: [f64; D] = spacing.try_into().map_err(|_| {
        PyValueError::new_err(format!("spacing must have {D} lengths, found {}", spacing.len()))
    })?;
    let shape = std::array::from_fn(|axis| shape[axis]);
    let mut relaxation = run(py, || {
        Relaxation::<D>::new(evidence, edges, shape, spacing, start, limits)
    })?;
    while !run(py, || Ok(relaxation.advance(STEPS)))? {}
    run(py, || Ok(relaxation.finish()))
}

/// `leading` axes of the evidence are no places.
fn relaxed<'py>(
    py: Python<'py>,
    evidence: &Image<'py>,
    edges: &Image<'py>,
    leading: usize,
    spacing: &[f64],
    start: Option<&Image<'py>>,
    limits: Limits,
) -> PyResult<Relaxed<'py>> {
    let whole = evidence.shape().to_vec();
    let shape = &whole[leading.min(whole.len())..];
    dimension(shape.len())?;
    let evidence = flat(evidence, &whole, "evidence")?;
    let edges = flat(edges, shape, "edges")?;
    let start = start.map(|s| flat(s, &whole, "start")).transpose()?;
    let kernel = if shape.len() == 2 { solve::<2> } else { solve::<3> };
    let (u, steps, gap) = kernel(py, evidence, edges, shape, spacing, start, limits)?;
    Ok((u.into_pyarray(py).reshape(whole)?, steps, gap))
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
) -> PyResult<Relaxed<'py>> {
    let limits = Limits { max_steps, tolerance };
    relaxed(py, &evidence, &edges, 0, &spacing, start.as_ref(), limits)
}

/// Shares (classes, shape) that minimise the sum over classes of edges |grad u| / 2 - evidence u; the number of steps, and
/// the duality gap relative to what the best labelling by one class alone could be improved by.
#[pyfunction]
#[pyo3(signature = (evidence, edges, spacing, start=None, max_steps=500, tolerance=3e-4))]
pub fn relaxed_classes<'py>(
    py: Python<'py>,
    evidence: Image<'py>,
    edges: Image<'py>,
    spacing: Vec<f64>,
    start: Option<Image<'py>>,
    max_steps: usize,
    tolerance: f64,
) -> PyResult<Relaxed<'py>> {
    if evidence.shape().first().is_none_or(|&classes| classes < 2) {
        return Err(PyValueError::new_err("evidence must be of two classes or more"));
    }
    let limits = Limits { max_steps, tolerance };
    relaxed(py, &evidence, &edges, 1, &spacing, start.as_ref(), limits)
}
