//! `SparseField`: a level set on a grid in motion.

use std::sync::Mutex;

use numpy::{IntoPyArray, PyArray1, PyArray2};
use pyo3::exceptions::{PyRuntimeError, PyValueError};
use pyo3::prelude::*;
use tspline_kernels::front::{Front, Order, Samples as Kernel, Terms};

use crate::blocks::{Blocks, Inner as Held};
use crate::convert::{points, run, table, values, Points, Values};

/// The front of either dimension.
enum Inner {
    Plane(Front<2>),
    Space(Front<3>),
}

/// One expression for both dimensions: `$f` is the kernel's front, `$d` its dimension.
macro_rules! each {
    ($front:expr, $f:ident => $body:expr) => {
        match $front {
            Inner::Plane($f) => $body,
            Inner::Space($f) => $body,
        }
    };
    ($front:expr, $f:ident, $d:ident => $body:expr) => {
        match $front {
            Inner::Plane($f) => {
                const $d: usize = 2;
                $body
            }
            Inner::Space($f) => {
                const $d: usize = 3;
                $body
            }
        }
    };
}

type Samples<'py> = (
    Bound<'py, PyArray2<f64>>,
    Bound<'py, PyArray2<f64>>,
    Bound<'py, PyArray1<f64>>,
    Bound<'py, PyArray1<f64>>,
);

/// Whitaker's sparse field, and its accurate kin: layers of nodes around the zero set that move with it.
#[pyclass(frozen, module = "tspline._core")]
pub struct SparseField {
    inner: Mutex<Inner>,
}

fn poisoned<T>(_: T) -> PyErr {
    PyRuntimeError::new_err("the sparse field was left unusable by an earlier failure")
}

fn front<const D: usize>(
    py: Python<'_>,
    kernel: &tspline_kernels::grid::Blocks<D>,
    spacing: &[f64],
    layers: usize,
    order: Order,
) -> PyResult<Front<D>> {
    let spacing: [f64; D] = spacing.try_into().map_err(|_| {
        PyValueError::new_err(format!("spacing must have {D} lengths, found {}", spacing.len()))
    })?;
    run(py, || Front::new(kernel, spacing, layers, order))
}

fn handed_out<const D: usize>(py: Python<'_>, samples: Kernel<D>) -> PyResult<Samples<'_>> {
    Ok((
        table(py, samples.points)?,
        table(py, samples.normals)?,
        samples.gradient_norm.into_pyarray(py),
        samples.weights.into_pyarray(py),
    ))
}

#[pymethods]
impl SparseField {
    /// The layers of a field that is about a distance near its zero set; lengths in the caller's units.
    #[new]
    fn new(py: Python<'_>, blocks: &Blocks, spacing: Vec<f64>, layers: usize, order: u8) -> PyResult<Self> {
        let order = match order {
            1 => Order::First,
            2 => Order::Second,
            _ => {
                return Err(PyValueError::new_err(format!(
                    "order: found {order}, accepted is 1 or 2"
                )))
            }
        };
        let inner = match &blocks.inner {
            Held::Plane(b) => Inner::Plane(front(py, b, &spacing, layers, order)?),
            Held::Space(b) => Inner::Space(front(py, b, &spacing, layers, order)?),
        };
        Ok(Self {
            inner: Mutex::new(inner),
        })
    }

    /// Number of nodes of the active layer.
    #[getter]
    fn num_active(&self) -> PyResult<usize> {
        let guard = self.inner.lock().map_err(poisoned)?;
        Ok(each!(&*guard, f => f.len()))
    }

    /// Number of nodes of all layers.
    #[getter]
    fn num_nodes(&self) -> PyResult<usize> {
        let guard = self.inner.lock().map_err(poisoned)?;
        Ok(each!(&*guard, f => f.num_covered()))
    }

    /// The values now.
    fn blocks(&self) -> PyResult<Blocks> {
        let guard = self.inner.lock().map_err(poisoned)?;
        Ok(each!(&*guard, f => f.blocks().clone().into()))
    }

    /// Samples of the zero set, measured from node 0: places, normals, |grad f|, shares of length or area. `staged`: of
    /// the first stage's zero set.
    fn samples<'py>(&self, py: Python<'py>, staged: bool) -> PyResult<Samples<'py>> {
        let guard = self.inner.lock().map_err(poisoned)?;
        let inner = &*guard;
        each!(inner, f => handed_out(py, run(py, || Ok(f.samples(staged)))?))
    }

    /// kappa = k1 + k2 at the samples.
    fn curvatures<'py>(&self, py: Python<'py>, staged: bool) -> PyResult<Bound<'py, PyArray1<f64>>> {
        let guard = self.inner.lock().map_err(poisoned)?;
        let inner = &*guard;
        each!(inner, f => Ok(run(py, || Ok(f.curvatures(staged)))?.into_pyarray(py)))
    }

    /// Principal curvatures at the samples, larger first; in the plane the second is 0.
    fn principal_curvatures<'py>(
        &self,
        py: Python<'py>,
        staged: bool,
    ) -> PyResult<Bound<'py, PyArray2<f64>>> {
        let guard = self.inner.lock().map_err(poisoned)?;
        let inner = &*guard;
        each!(inner, f => table(py, run(py, || Ok(f.principal_curvatures(staged)))?))
    }

    /// One stage of a step with the speed's terms at its samples. Returns the largest change of an active node so far,
    /// in the smallest spacings, and the root mean square, caller's units.
    fn advance(
        &self,
        py: Python<'_>,
        normal: Values<'_>,
        advection: Option<Points<'_>>,
        smoothing: Option<Values<'_>>,
        step: f64,
        staged: bool,
    ) -> PyResult<(f64, f64)> {
        let normal = values(&normal, "normal")?;
        let smoothing = smoothing.as_ref().map(|s| values(s, "smoothing")).transpose()?;
        let mut guard = self.inner.lock().map_err(poisoned)?;
        let inner = &mut *guard;
        each!(inner, f, D => {
            let advection = advection.as_ref().map(|a| points::<D>(a, "advection")).transpose()?;
            let terms = Terms { normal, advection, smoothing };
            run(py, || f.advance(terms, step, staged))
        })
    }

    /// Drop the stages since the last `commit`.
    fn undo(&self) -> PyResult<()> {
        let mut guard = self.inner.lock().map_err(poisoned)?;
        each!(&mut *guard, f => f.undo());
        Ok(())
    }

    /// Make the stages' values the field's, and let the layers follow the zero set.
    fn commit(&self, py: Python<'_>) -> PyResult<()> {
        let mut guard = self.inner.lock().map_err(poisoned)?;
        let inner = &mut *guard;
        run(py, || {
            each!(inner, f => f.commit());
            Ok(())
        })
    }

    /// Raise RuntimeError when a layer is not what it should be.
    fn check_invariants(&self, py: Python<'_>) -> PyResult<()> {
        let guard = self.inner.lock().map_err(poisoned)?;
        let inner = &*guard;
        run(py, || each!(inner, f => f.check_invariants()))
    }
}
