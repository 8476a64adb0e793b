//! The one place where arrays and errors cross the border.

use numpy::{
    IntoPyArray, PyArray1, PyArray2, PyArray3, PyArrayMethods, PyReadonlyArray1, PyReadonlyArray2,
    PyUntypedArrayMethods,
};
use pyo3::exceptions::{PyMemoryError, PyRuntimeError, PyValueError};
use pyo3::prelude::*;
use tspline_kernels::bulk::Field;
use tspline_kernels::net::Loops;
use tspline_kernels::surface::Surface;
use tspline_kernels::KernelError;

pub type Points<'py> = PyReadonlyArray2<'py, f64>;
pub type Values<'py> = PyReadonlyArray1<'py, f64>;
/// Values, and gradients and Hessians if asked for.
pub type Jets<'py> = (
    Bound<'py, PyArray1<f64>>,
    Option<Bound<'py, PyArray2<f64>>>,
    Option<Bound<'py, PyArray3<f64>>>,
);
/// Vertices of closed lines, and where each line starts.
pub type Lines<'py> = (Bound<'py, PyArray2<f64>>, Bound<'py, PyArray1<i64>>);
/// Vertices, normals and faces.
pub type Triangles<'py> = (
    Bound<'py, PyArray2<f64>>,
    Bound<'py, PyArray2<f64>>,
    Bound<'py, PyArray2<i64>>,
);

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

/// What was asked of a field at points.
pub fn jets<const D: usize>(py: Python<'_>, field: Field<D>, order: usize) -> PyResult<Jets<'_>> {
    let n = field.values.len();
    let gradients = (order >= 1).then(|| table(py, field.gradients)).transpose()?;
    let hessians = (order >= 2)
        .then(|| {
            let flat = field.hessians.into_flattened().into_flattened();
            flat.into_pyarray(py).reshape([n, D, D])
        })
        .transpose()?;
    Ok((field.values.into_pyarray(py), gradients, hessians))
}

/// Closed lines.
pub fn lines(py: Python<'_>, loops: Loops) -> PyResult<Lines<'_>> {
    let start: Vec<i64> = loops.start.iter().map(|&s| s as i64).collect();
    Ok((table(py, loops.vertices)?, start.into_pyarray(py)))
}

/// A triangle mesh.
pub fn triangles(py: Python<'_>, surface: Surface) -> PyResult<Triangles<'_>> {
    let count = surface.triangles.len();
    let faces = surface.triangles.into_flattened().into_pyarray(py);
    Ok((
        table(py, surface.vertices)?,
        table(py, surface.normals)?,
        faces.reshape([count, 3])?,
    ))
}
