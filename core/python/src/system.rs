//! `System`: the normal equations of one mesh.

use std::sync::{Arc, Mutex};

use numpy::{IntoPyArray, PyArray1};
use pyo3::exceptions::{PyRuntimeError, PyValueError};
use pyo3::prelude::*;
use tspline_kernels::{Equations, System as Kernel, TMesh as KernelMesh};

use crate::convert::{points, run, values, Points, Values};
use crate::mesh::{Mesh, TMesh};

enum Inner {
    Plane(Arc<KernelMesh<2>>, Kernel<2>),
    Space(Arc<KernelMesh<3>>, Kernel<3>),
}

type Solution<'py> = (
    Bound<'py, PyArray1<f64>>,
    Bound<'py, PyArray1<f64>>,
    f64,
    usize,
    bool,
);
type Matrix<'py> = (
    Bound<'py, PyArray1<i64>>,
    Bound<'py, PyArray1<i64>>,
    Bound<'py, PyArray1<f64>>,
);

/// The normal equations of E + omega S on one mesh: pattern made once, values refilled at every `solve`.
#[pyclass(frozen, module = "tspline._core")]
pub struct System {
    inner: Mutex<Inner>,
}

fn poisoned<T>(_: T) -> PyErr {
    PyRuntimeError::new_err("the system was left unusable by an earlier failure")
}

#[pymethods]
impl System {
    #[new]
    fn new(py: Python<'_>, mesh: &TMesh) -> PyResult<Self> {
        let inner = match &mesh.inner {
            Mesh::Plane(m) => Inner::Plane(Arc::clone(m), run(py, || Kernel::new(m))?),
            Mesh::Space(m) => Inner::Space(Arc::clone(m), run(py, || Kernel::new(m))?),
        };
        Ok(Self {
            inner: Mutex::new(inner),
        })
    }

    /// Rates, realised normal speeds at the samples, rms of |grad f| - 1, iterations, whether a new factor was made.
    #[pyo3(signature = (c, samples, weights, speed, smoothing, *, time_step, constraint_weight, relaxation,
        constraint_band, far_weight, fairness, damping, tolerance, plain=false, warm=None, diagonal=0))]
    fn solve<'py>(
        &self,
        py: Python<'py>,
        c: Values<'py>,
        samples: Points<'py>,
        weights: Values<'py>,
        speed: Values<'py>,
        smoothing: Option<Values<'py>>,
        time_step: f64,
        constraint_weight: f64,
        relaxation: f64,
        constraint_band: f64,
        far_weight: f64,
        fairness: f64,
        damping: f64,
        tolerance: f64,
        plain: bool,
        warm: Option<Values<'py>>,
        diagonal: usize,
    ) -> PyResult<Solution<'py>> {
        let c = values(&c, "coefficients")?;
        let (weights, speed) = (values(&weights, "weights")?, values(&speed, "speed")?);
        let smoothing = smoothing.as_ref().map(|s| values(s, "smoothing")).transpose()?;
        let warm = warm.as_ref().map(|w| values(w, "warm")).transpose()?;
        let mut inner = self.inner.lock().map_err(poisoned)?;
        macro_rules! solve {
            ($m:ident, $kernel:ident, $d:literal) => {{
                let equations = Equations::<'_, $d> {
                    coefficients: c,
                    points: points::<$d>(&samples, "samples")?,
                    weights,
                    speed,
                    smoothing,
                    time_step,
                    constraint_weight,
                    relaxation,
                    constraint_band,
                    far_weight,
                    fairness,
                    damping,
                    tolerance,
                    plain,
                    diagonal,
                };
                run(py, || $kernel.solve($m, &equations, warm))?
            }};
        }
        let r = match &mut *inner {
            Inner::Plane(m, kernel) => solve!(m, kernel, 2),
            Inner::Space(m, kernel) => solve!(m, kernel, 3),
        };
        Ok((
            r.rates.into_pyarray(py),
            r.realised.into_pyarray(py),
            r.gradient_deviation,
            r.iterations,
            r.factorised,
        ))
    }

    /// The matrix of the last `solve`: CSR row starts, columns, values.
    fn matrix<'py>(&self, py: Python<'py>) -> PyResult<Matrix<'py>> {
        let inner = self.inner.lock().map_err(poisoned)?;
        let (start, columns, entries) = match &*inner {
            Inner::Plane(_, kernel) => kernel.matrix(),
            Inner::Space(_, kernel) => kernel.matrix(),
        };
        let start: Vec<i64> = start.iter().map(|&s| s as i64).collect();
        let columns: Vec<i64> = columns.iter().map(|&s| i64::from(s)).collect();
        if entries.is_empty() {
            return Err(PyValueError::new_err("nothing was solved yet"));
        }
        Ok((
            start.into_pyarray(py),
            columns.into_pyarray(py),
            entries.to_vec().into_pyarray(py),
        ))
    }

    /// Entries of the matrix and of its factor.
    #[getter]
    fn fill(&self) -> PyResult<(usize, usize)> {
        let mut inner = self.inner.lock().map_err(poisoned)?;
        Ok(match &mut *inner {
            Inner::Plane(m, kernel) => kernel.fill(m),
            Inner::Space(m, kernel) => kernel.fill(m),
        })
    }
}
