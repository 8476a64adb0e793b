//! The one place where arrays and errors cross the border.

use numpy::{
    IntoPyArray, PyArray2, PyArrayMethods, PyReadonlyArray1, PyReadonlyArray2, PyUntypedArrayMethods,
};
use pyo3::exceptions::{PyMemoryError, PyRuntimeError, PyValueError};
use pyo3::prelude::*;
use tspline_kernels::KernelError;

pub type Points<'py> = PyReadonlyArray2<'py, f64>;
pub type Values<'py> = PyReadonlyArray1<'py, f64>;

/// A kernel error as the Python exception of its kind.
pub fn raise(error: KernelError) -> PyErr {
    match error {
        KernelError::Invalid(text) => PyValueError::new_err(text),
        KernelError::TooLarge(text) => PyMemoryError::new_err(text),
        KernelError::NotSolved(text) => PyRuntimeError::new_err(text),
    }
}

/// Run a kernel without the GIL; its error becomes an exception, a pending Ctrl-C is raised after it.
pub fn run<T: Send>(
    py: Python<'_>,
    kernel: impl Send + FnOnce() -> tspline_kernels::Result<T>,
) -> PyResult<T> {
    let result = py.detach(kernel).map_err(raise);
    py.check_signals()?;
    result
}

/// Refuse dimensions other than 2 and 3.
pub fn dimension(dim: usize) -> PyResult<()> {
    if dim == 2 || dim == 3 {
        Ok(())
    } else {
        Err(PyValueError::new_err(format!(
            "dim: found {dim}, accepted is 2 or 3"
        )))
    }
}

/// Contiguous values.
pub fn values<'a>(array: &'a Values<'_>, name: &str) -> PyResult<&'a [f64]> {
    array
        .as_slice()
        .map_err(|_| PyValueError::new_err(format!("{name} must be C-contiguous")))
}

/// Contiguous points with D columns.
pub fn points<'a, const D: usize>(array: &'a Points<'_>, name: &str) -> PyResult<&'a [[f64; D]]> {
    if array.as_array().ncols() != D {
        return Err(PyValueError::new_err(format!(
            "{name} must have {D} columns, found {}",
            array.as_array().ncols()
        )));
    }
    // `as_slice` takes column-major arrays too, and would read them in the wrong order.
    let flat = array
        .as_slice()
        .ok()
        .filter(|_| array.is_c_contiguous())
        .ok_or_else(|| PyValueError::new_err(format!("{name} must be C-contiguous")))?;
    // Whole rows only: the array has D columns.
    Ok(bytemuck::cast_slice(flat))
}

/// Rows of N numbers as an array (n, N).
pub fn table<const N: usize>(py: Python<'_>, rows: Vec<[f64; N]>) -> PyResult<Bound<'_, PyArray2<f64>>> {
    let count = rows.len();
    rows.into_flattened().into_pyarray(py).reshape([count, N])
}
