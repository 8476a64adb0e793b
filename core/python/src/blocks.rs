//! `Blocks`: frozen node values of a grid, kept near the zero set.

use std::sync::Arc;

use numpy::{
    IntoPyArray, PyArray1, PyArray2, PyArrayDyn, PyArrayMethods, PyReadonlyArray1, PyReadonlyArray2,
    PyReadonlyArrayDyn, PyUntypedArrayMethods,
};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use tspline_kernels::grid::{interpolant, loops, redistance, surface, Blocks as Kernel, Interpolant};
use tspline_kernels::project::{self, Limits};

use crate::convert::{dimension, jets, lines, points, run, table, triangles, Jets, Lines, Points, Triangles};

/// The values of either dimension.
#[derive(Clone)]
pub enum Inner {
    Plane(Arc<Kernel<2>>),
    Space(Arc<Kernel<3>>),
}

/// One expression for both dimensions: `$b` is the kernel's blocks, `$d` its dimension.
macro_rules! each_grid {
    ($blocks:expr, $b:ident => $body:expr) => {
        match $blocks {
            $crate::blocks::Inner::Plane($b) => $body,
            $crate::blocks::Inner::Space($b) => $body,
        }
    };
    ($blocks:expr, $b:ident, $d:ident => $body:expr) => {
        match $blocks {
            $crate::blocks::Inner::Plane($b) => {
                const $d: usize = 2;
                $body
            }
            $crate::blocks::Inner::Space($b) => {
                const $d: usize = 3;
                $body
            }
        }
    };
}

/// Frozen node values in blocks of eight nodes an axis; blocks whose values all lie far off keep only their sign.
#[pyclass(frozen, module = "tspline._core")]
pub struct Blocks {
    pub inner: Inner,
}

impl From<Kernel<2>> for Blocks {
    fn from(kernel: Kernel<2>) -> Self {
        Self {
            inner: Inner::Plane(Arc::new(kernel)),
        }
    }
}

impl From<Kernel<3>> for Blocks {
    fn from(kernel: Kernel<3>) -> Self {
        Self {
            inner: Inner::Space(Arc::new(kernel)),
        }
    }
}

impl Blocks {
    /// The values of a planar grid.
    pub fn plane(&self, what: &str) -> PyResult<Arc<Kernel<2>>> {
        match &self.inner {
            Inner::Plane(b) => Ok(Arc::clone(b)),
            Inner::Space(_) => Err(PyValueError::new_err(format!("{what} is for planar grids"))),
        }
    }

    /// The values of a grid in space.
    pub fn space(&self, what: &str) -> PyResult<Arc<Kernel<3>>> {
        match &self.inner {
            Inner::Space(b) => Ok(Arc::clone(b)),
            Inner::Plane(_) => Err(PyValueError::new_err(format!("{what} is for grids in space"))),
        }
    }
}

/// One length an axis.
fn lengths<const D: usize>(given: &[f64]) -> PyResult<[f64; D]> {
    given
        .try_into()
        .map_err(|_| PyValueError::new_err(format!("spacing must have {D} lengths, found {}", given.len())))
}

fn parts<const D: usize>(
    py: Python<'_>,
    shape: &[usize],
    far: f64,
    places: &PyReadonlyArray2<'_, u32>,
    values: &[f64],
    inside: &[bool],
) -> PyResult<Kernel<D>> {
    let rows = places.as_array();
    if rows.ncols() != D {
        return Err(PyValueError::new_err(format!(
            "places must have {D} columns, found {}",
            rows.ncols()
        )));
    }
    let places: Vec<[u32; D]> = rows
        .rows()
        .into_iter()
        .map(|r| std::array::from_fn(|a| r[a]))
        .collect();
    let shape: [usize; D] = std::array::from_fn(|a| shape[a]);
    run(py, || Kernel::from_parts(shape, far, &places, values, inside))
}

#[pymethods]
impl Blocks {
    /// The blocks of an array with 2 or 3 axes that hold a value below `far` in magnitude or both signs; all of them
    /// when `far` is infinite.
    #[staticmethod]
    fn from_dense(py: Python<'_>, values: PyReadonlyArrayDyn<'_, f64>, far: f64) -> PyResult<Self> {
        let shape = values.shape().to_vec();
        dimension(shape.len())?;
        let flat = values
            .as_slice()
            .ok()
            .filter(|_| values.is_c_contiguous())
            .ok_or_else(|| PyValueError::new_err("values must be C-contiguous"))?;
        Ok(if shape.len() == 2 {
            run(py, || Kernel::from_dense([shape[0], shape[1]], flat, far))?.into()
        } else {
            run(py, || {
                Kernel::from_dense([shape[0], shape[1], shape[2]], flat, far)
            })?
            .into()
        })
    }

    /// Blocks at `places` (m, d), counted in blocks, with values (m, 8^d); `inside` (one entry a block of the grid,
    /// C order) tells the sign of all others.
    #[staticmethod]
    fn from_parts(
        py: Python<'_>,
        shape: Vec<usize>,
        far: f64,
        places: PyReadonlyArray2<'_, u32>,
        values: PyReadonlyArray2<'_, f64>,
        inside: PyReadonlyArray1<'_, bool>,
    ) -> PyResult<Self> {
        dimension(shape.len())?;
        if values.shape() != [places.shape()[0], 8_usize.pow(shape.len() as u32)] {
            return Err(PyValueError::new_err(
                "values must have a row of 8^d for each place",
            ));
        }
        let flat = values
            .as_slice()
            .ok()
            .filter(|_| values.is_c_contiguous())
            .ok_or_else(|| PyValueError::new_err("values must be C-contiguous"))?;
        let inside = inside
            .as_slice()
            .map_err(|_| PyValueError::new_err("inside must be contiguous"))?;
        Ok(if shape.len() == 2 {
            parts::<2>(py, &shape, far, &places, flat, inside)?.into()
        } else {
            parts::<3>(py, &shape, far, &places, flat, inside)?.into()
        })
    }

    /// All values, (n_0, ..): +far or -far where no block is stored.
    fn to_dense<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArrayDyn<f64>>> {
        each_grid!(&self.inner, b => {
            let dense = run(py, || Ok(b.to_dense()))?;
            dense.into_pyarray(py).reshape(b.shape().to_vec())
        })
    }

    /// Nodes an axis.
    #[getter]
    fn shape(&self) -> Vec<usize> {
        each_grid!(&self.inner, b => b.shape().to_vec())
    }

    /// Blocks an axis.
    #[getter]
    fn counts(&self) -> Vec<usize> {
        each_grid!(&self.inner, b => b.counts().to_vec())
    }

    /// |value| of what is not stored.
    #[getter]
    fn far(&self) -> f64 {
        each_grid!(&self.inner, b => b.far())
    }

    /// Place of each stored block in blocks, (m, d).
    #[getter]
    fn places<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<u32>>> {
        each_grid!(&self.inner, b, D => {
            let flat = b.places().as_flattened().to_vec();
            flat.into_pyarray(py).reshape([b.len(), D])
        })
    }

    /// Values of the stored blocks, (m, 8^d); nodes beyond the grid repeat the nearest one.
    #[getter]
    fn values<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<f64>>> {
        each_grid!(&self.inner, b, D => {
            b.values().to_vec().into_pyarray(py).reshape([b.len(), Kernel::<D>::VOLUME])
        })
    }

    /// Sign of the blocks that are not stored, one entry a block of the grid, C order; stored ones count as outside.
    #[getter]
    fn inside<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<bool>> {
        each_grid!(&self.inner, b => b.inside().into_pyarray(py))
    }

    /// Number of stored blocks.
    #[getter]
    fn num_blocks(&self) -> usize {
        each_grid!(&self.inner, b => b.len())
    }
    /// The largest |value| of a stored block, 0 without one.
    #[getter]
    fn largest(&self) -> f64 {
        each_grid!(&self.inner, b => b.values().iter().fold(0.0, |m, v| v.abs().max(m)))
    }

    /// Values, gradients (order >= 1) and Hessians (order 2) at index coordinates (k, d), derivatives in the unit of
    /// `spacing`; outside +inf and NaN.
    fn evaluate<'py>(
        &self,
        py: Python<'py>,
        at: Points<'py>,
        spacing: Vec<f64>,
        order: usize,
    ) -> PyResult<Jets<'py>> {
        each_grid!(&self.inner, b, D => {
            let (xs, spacing) = (points::<D>(&at, "points")?, lengths::<D>(&spacing)?);
            let field = run(py, || interpolant::evaluate(b, &spacing, xs, order))?;
            jets(py, field, order)
        })
    }

    /// Foot points on the zero set from given starts, and whether each was reached; all places are measured from the
    /// first node in the unit of `spacing`.
    fn project<'py>(
        &self,
        py: Python<'py>,
        at: Points<'py>,
        starts: Points<'py>,
        spacing: Vec<f64>,
        max_travel: f64,
    ) -> PyResult<(Bound<'py, PyArray2<f64>>, Bound<'py, PyArray1<bool>>)> {
        each_grid!(&self.inner, b, D => {
            let (xs, from) = (points::<D>(&at, "points")?, points::<D>(&starts, "starts")?);
            if xs.len() != from.len() {
                return Err(PyValueError::new_err("as many starts as points are needed"));
            }
            let spacing = lengths::<D>(&spacing)?;
            let (feet, ok) = run(py, || {
                interpolant::check_spacing(&spacing)?;
                let limits = Limits {
                    high: std::array::from_fn(|a| (b.shape()[a] - 1) as f64 * spacing[a]),
                    scale: project::largest(b.values()),
                    max_travel,
                };
                Ok(project::project_on(|| Interpolant::new(b, &spacing), &limits, xs, from))
            })?;
            Ok((table(py, feet)?, ok.into_pyarray(py)))
        })
    }

    /// Closed polylines on the zero set of a planar grid: vertices (k, 2) in index coordinates and where each line
    /// starts, (l + 1,).
    fn loops<'py>(&self, py: Python<'py>, subdivision: u8) -> PyResult<Lines<'py>> {
        let blocks = self.plane("loops")?;
        let found = run(py, || loops::loops(&blocks, subdivision))?;
        lines(py, found)
    }

    /// Closed triangle mesh on the zero set of a grid in space: vertices (n, 3), unit normals (n, 3), triangles (m, 3),
    /// and the upper corner of the box (3,). Places are measured from the first node in the unit of `spacing`; the
    /// lattice is `2^subdivision` times as fine as the grid.
    fn surface<'py>(
        &self,
        py: Python<'py>,
        spacing: Vec<f64>,
        subdivision: i8,
    ) -> PyResult<(Triangles<'py>, [f64; 3])> {
        let (blocks, spacing) = (self.space("surface")?, lengths::<3>(&spacing)?);
        let (found, high) = run(py, || surface::surface(&blocks, &spacing, subdivision))?;
        Ok((triangles(py, found)?, high))
    }

    /// Signed distances within `band` of the zero set, +band or -band elsewhere; everywhere if it is infinite.
    fn redistance(&self, py: Python<'_>, spacing: Vec<f64>, band: f64) -> PyResult<Self> {
        each_grid!(&self.inner, b, D => {
            let spacing = lengths::<D>(&spacing)?;
            Ok(run(py, || redistance::redistance(b, &spacing, band))?.into())
        })
    }
}
