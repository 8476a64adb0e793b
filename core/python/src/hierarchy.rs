//! `Hierarchy`: levels of uniform cubic B-splines near a cloud, fitted coarse to fine.

use std::sync::Mutex;

use numpy::{IntoPyArray, PyArray1, PyArray2, PyArrayMethods, PyReadonlyArray2, PyReadonlyArray3};
use pyo3::exceptions::{PyRuntimeError, PyValueError};
use pyo3::prelude::*;
use tspline_kernels::hierarchy::{Hierarchy as Kernel, Weights};
use tspline_kernels::lattice;
use tspline_kernels::rows::Target;

use crate::convert::{points, run, table, values, Points, Values};

type Jets<'py> = (
    Bound<'py, PyArray1<f64>>,
    Bound<'py, PyArray2<f64>>,
    Bound<'py, PyArray1<u8>>,
);

/// Fields of cubic B-splines on nested lattices over the unit box.
#[pyclass(frozen, module = "tspline._core")]
pub struct Hierarchy {
    inner: Mutex<Kernel>,
}

fn triples(cells: &PyReadonlyArray2<'_, u32>) -> PyResult<Vec<[u32; 3]>> {
    let rows = cells.as_array();
    if rows.ncols() != 3 {
        return Err(PyValueError::new_err("cells must have 3 columns"));
    }
    Ok(rows.rows().into_iter().map(|r| [r[0], r[1], r[2]]).collect())
}

fn poisoned<T>(_: T) -> PyErr {
    PyRuntimeError::new_err("the hierarchy was left unusable by an earlier failure")
}

#[pymethods]
impl Hierarchy {
    /// All cells of `level`, coefficients 0.
    #[new]
    fn new(py: Python<'_>, level: u8) -> PyResult<Self> {
        let inner = Mutex::new(run(py, || Kernel::new(level))?);
        Ok(Self { inner })
    }

    /// The next level near `cells` (m, 3), whose parents were cells of the finest one.
    fn refine(&self, py: Python<'_>, cells: PyReadonlyArray2<'_, u32>) -> PyResult<()> {
        let cells = triples(&cells)?;
        let mut guard = self.inner.lock().map_err(poisoned)?;
        let inner = &mut *guard;
        run(py, || inner.refine(&cells))
    }

    /// The cells (m, 3) of a lattice with n cells an axis that are at most `radius` away from `cells`, in order.
    #[staticmethod]
    fn around<'py>(
        py: Python<'py>,
        cells: PyReadonlyArray2<'_, u32>,
        n: u32,
        radius: u32,
    ) -> PyResult<Bound<'py, PyArray2<u32>>> {
        let cells = triples(&cells)?;
        let found = run(py, || lattice::around(&cells, n, radius))?;
        let count = found.len();
        found.into_flattened().into_pyarray(py).reshape([count, 3])
    }

    /// Drop the finest level.
    fn retreat(&self, py: Python<'_>) -> PyResult<()> {
        let mut guard = self.inner.lock().map_err(poisoned)?;
        let inner = &mut *guard;
        run(py, || inner.retreat())
    }

    /// Fit the finest level; returns iterations, whether the tolerance was reached, and unknowns.
    #[pyo3(signature = (at, weights, targets, normal_weights, normals, *, smoothing, kink, tangential, tolerance,
        max_iterations, slope = 1.0))]
    fn fit(
        &self,
        py: Python<'_>,
        at: Points<'_>,
        weights: Values<'_>,
        targets: Values<'_>,
        normal_weights: Values<'_>,
        normals: Points<'_>,
        smoothing: f64,
        kink: f64,
        tangential: f64,
        tolerance: f64,
        max_iterations: usize,
        slope: f64,
    ) -> PyResult<(usize, bool, usize)> {
        let at = points::<3>(&at, "points")?;
        let normals = points::<3>(&normals, "normals")?;
        let (a, t) = (values(&weights, "weights")?, values(&targets, "targets")?);
        let b = values(&normal_weights, "normal_weights")?;
        if [a.len(), t.len(), b.len(), normals.len()]
            .iter()
            .any(|&l| l != at.len())
        {
            return Err(PyValueError::new_err(
                "weights, targets and normals must have one entry a point",
            ));
        }
        let mut guard = self.inner.lock().map_err(poisoned)?;
        let inner = &mut *guard;
        let outcome = run(py, || {
            let targets: Vec<Target> = (0..at.len())
                .map(|p| Target {
                    weight: a[p],
                    value: t[p],
                    normal_weight: b[p],
                    normal: normals[p],
                    slope,
                })
                .collect();
            let weights = Weights {
                smoothing,
                kink,
                tangential,
                tolerance,
                max_iterations,
            };
            inner.fit(at, &targets, &weights)
        })?;
        Ok((outcome.iterations, outcome.converged, outcome.unknowns))
    }

    /// Values, gradients and the level that each was taken from.
    fn evaluate<'py>(&self, py: Python<'py>, at: Points<'_>) -> PyResult<Jets<'py>> {
        let at = points::<3>(&at, "points")?;
        let guard = self.inner.lock().map_err(poisoned)?;
        let inner = &*guard;
        let jets = run(py, || Ok(inner.evaluate(at)))?;
        let value: Vec<f64> = jets.iter().map(|(j, _)| j[0]).collect();
        let level: Vec<u8> = jets.iter().map(|&(_, l)| l).collect();
        let gradient = table(py, jets.iter().map(|(j, _)| [j[1], j[2], j[3]]).collect())?;
        Ok((value.into_pyarray(py), gradient, level.into_pyarray(py)))
    }

    /// Laplacians at points (n, 3), shape (n,); NaN outside of all lattices.
    fn laplacians<'py>(&self, py: Python<'py>, at: Points<'_>) -> PyResult<Bound<'py, PyArray1<f64>>> {
        let at = points::<3>(&at, "points")?;
        let guard = self.inner.lock().map_err(poisoned)?;
        let inner = &*guard;
        Ok(run(py, || Ok(inner.laplacians(at)))?.into_pyarray(py))
    }

    /// Coefficients of the T-spline with local knots (n, 3, 5), by dual functionals.
    fn coefficients<'py>(
        &self,
        py: Python<'py>,
        knots: PyReadonlyArray3<'_, f64>,
    ) -> PyResult<Bound<'py, PyArray1<f64>>> {
        let shape = knots.as_array().shape().to_vec();
        if shape[1..] != [3, 5] {
            return Err(PyValueError::new_err("knots must have shape (n, 3, 5)"));
        }
        let rows = knots.as_array();
        let knots: Vec<[[f64; 5]; 3]> = rows
            .outer_iter()
            .map(|k| std::array::from_fn(|a| std::array::from_fn(|q| k[[a, q]])))
            .collect();
        let guard = self.inner.lock().map_err(poisoned)?;
        let inner = &*guard;
        Ok(run(py, || inner.coefficients(&knots))?.into_pyarray(py))
    }

    /// Stored nodes of each level, coarsest first.
    #[getter]
    fn sizes(&self) -> PyResult<Vec<usize>> {
        let guard = self.inner.lock().map_err(poisoned)?;
        let inner = &*guard;
        Ok(inner
            .levels()
            .iter()
            .map(tspline_kernels::lattice::Lattice::len)
            .collect())
    }
}
