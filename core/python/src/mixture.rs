//! Mixtures of normal distributions.

use numpy::{
    IntoPyArray, PyArray1, PyReadonlyArray1, PyReadonlyArray2, PyReadonlyArray3, PyUntypedArrayMethods,
};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use tspline_kernels::mixture::Mixture;

/// log of sum_k exp(constants[k] - |whitening[k] x - centres[k]|^2 / 2) at rows of values.
#[pyfunction]
pub fn mixture_log_density<'py>(
    py: Python<'py>,
    values: PyReadonlyArray2<'py, f32>,
    whitening: PyReadonlyArray3<'py, f32>,
    centres: PyReadonlyArray2<'py, f32>,
    constants: PyReadonlyArray1<'py, f32>,
) -> PyResult<Bound<'py, PyArray1<f32>>> {
    let (rows, channels, parts) = (values.shape()[0], values.shape()[1], constants.len());
    if whitening.shape() != [parts, channels, channels] || centres.shape() != [parts, channels] || parts == 0
    {
        return Err(PyValueError::new_err(
            "whitening, centres and constants do not fit the values",
        ));
    }
    let mixture = Mixture {
        channels,
        whitening: whitening.as_slice()?,
        centres: centres.as_slice()?,
        constants: constants.as_slice()?,
    };
    let values = values.as_slice()?;
    let mut density = vec![0.0; rows];
    py.detach(|| mixture.log_density(values, &mut density));
    Ok(density.into_pyarray(py))
}
