//! `TMesh`: the frozen T-mesh and everything that is asked of a T-spline on it.

use std::sync::Arc;

use numpy::{IntoPyArray, PyArray1, PyArray2, PyArray3, PyArrayMethods, PyReadonlyArray1, PyReadonlyArray2};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use tspline_kernels::evaluate::{self, Jet};
use tspline_kernels::refine;
use tspline_kernels::tree::{Leaf, Tree};
use tspline_kernels::{bulk, contour, project, surface, TMesh as Kernel};

use crate::convert::{
    dimension, jets, lines, points, raise, run, table, triangles, values, Jets, Lines, Points, Triangles,
    Values,
};

/// The mesh of either dimension.
#[derive(Clone)]
pub enum Mesh {
    Plane(Arc<Kernel<2>>),
    Space(Arc<Kernel<3>>),
}

/// One expression for both dimensions: `$m` is the kernel's mesh, `$d` its dimension.
macro_rules! each {
    ($mesh:expr, $m:ident => $body:expr) => {
        match $mesh {
            Mesh::Plane($m) => $body,
            Mesh::Space($m) => $body,
        }
    };
    ($mesh:expr, $m:ident, $d:ident => $body:expr) => {
        match $mesh {
            Mesh::Plane($m) => {
                const $d: usize = 2;
                $body
            }
            Mesh::Space($m) => {
                const $d: usize = 3;
                $body
            }
        }
    };
}

type Rows<'py> = (
    Bound<'py, PyArray1<i64>>,
    Bound<'py, PyArray1<i64>>,
    Vec<Bound<'py, PyArray1<f64>>>,
);

/// A frozen T-mesh over the unit box.
#[pyclass(frozen, module = "tspline._core")]
pub struct TMesh {
    pub inner: Mesh,
}

fn leaves<const D: usize>(corners: &PyReadonlyArray2<'_, u32>, levels: &[u8]) -> PyResult<Vec<Leaf<D>>> {
    let view = corners.as_array();
    if view.ncols() != D || view.nrows() != levels.len() {
        return Err(PyValueError::new_err(format!(
            "corners must be ({}, {D}), found ({}, {})",
            levels.len(),
            view.nrows(),
            view.ncols()
        )));
    }
    let leaf = |(row, &level): (numpy::ndarray::ArrayView1<'_, u32>, &u8)| Leaf {
        corner: std::array::from_fn(|a| row[a]),
        level,
    };
    Ok(view.rows().into_iter().zip(levels).map(leaf).collect())
}

fn plane(mesh: &Mesh, what: &str) -> PyResult<Arc<Kernel<2>>> {
    match mesh {
        Mesh::Plane(m) => Ok(Arc::clone(m)),
        Mesh::Space(_) => Err(PyValueError::new_err(format!("{what} is for planar meshes"))),
    }
}

fn space(mesh: &Mesh, what: &str) -> PyResult<Arc<Kernel<3>>> {
    match mesh {
        Mesh::Space(m) => Ok(Arc::clone(m)),
        Mesh::Plane(_) => Err(PyValueError::new_err(format!("{what} is for meshes in space"))),
    }
}

#[pymethods]
impl TMesh {
    /// `2^depth` cells an axis.
    #[staticmethod]
    fn uniform(py: Python<'_>, dim: usize, depth: u8) -> PyResult<Self> {
        dimension(dim)?;
        let inner = run(py, || {
            Ok(if dim == 2 {
                Mesh::Plane(Arc::new(Kernel::uniform(depth)?))
            } else {
                Mesh::Space(Arc::new(Kernel::uniform(depth)?))
            })
        })?;
        Ok(Self { inner })
    }

    /// The mesh with exactly the given leaves; refused when they do not tile the box or are not graded.
    #[staticmethod]
    fn from_leaves(
        py: Python<'_>,
        corners: PyReadonlyArray2<'_, u32>,
        levels: PyReadonlyArray1<'_, u8>,
    ) -> PyResult<Self> {
        let dim = corners.as_array().ncols();
        dimension(dim)?;
        let levels = levels
            .as_slice()
            .map_err(|_| PyValueError::new_err("levels must be contiguous"))?;
        let inner = if dim == 2 {
            let list = leaves::<2>(&corners, levels)?;
            Mesh::Plane(Arc::new(run(py, || Kernel::new(Tree::from_leaves(&list)?))?))
        } else {
            let list = leaves::<3>(&corners, levels)?;
            Mesh::Space(Arc::new(run(py, || Kernel::new(Tree::from_leaves(&list)?))?))
        };
        Ok(Self { inner })
    }

    /// At least `levels[k]` in a block of `pad` cells around `points[k]`, at least `base` everywhere, graded.
    #[staticmethod]
    fn from_points(
        py: Python<'_>,
        at: Points<'_>,
        levels: PyReadonlyArray1<'_, u8>,
        pad: u32,
        base: u8,
        max_cells: usize,
    ) -> PyResult<Self> {
        let dim = at.as_array().ncols();
        dimension(dim)?;
        let levels = levels
            .as_slice()
            .map_err(|_| PyValueError::new_err("levels must be contiguous"))?;
        let inner = if dim == 2 {
            let list = points::<2>(&at, "points")?;
            Mesh::Plane(Arc::new(run(py, || {
                refine::from_points(list, levels, pad, base, max_cells)
            })?))
        } else {
            let list = points::<3>(&at, "points")?;
            Mesh::Space(Arc::new(run(py, || {
                refine::from_points(list, levels, pad, base, max_cells)
            })?))
        };
        Ok(Self { inner })
    }

    /// Every marked leaf split once, grading restored.
    fn refine(&self, py: Python<'_>, mask: PyReadonlyArray1<'_, bool>) -> PyResult<Self> {
        let mask = mask
            .as_slice()
            .map_err(|_| PyValueError::new_err("mask must be contiguous"))?;
        let inner = match &self.inner {
            Mesh::Plane(m) => Mesh::Plane(Arc::new(run(py, || refine::refine(m, mask))?)),
            Mesh::Space(m) => Mesh::Space(Arc::new(run(py, || refine::refine(m, mask))?)),
        };
        Ok(Self { inner })
    }

    /// Complete families of marked leaves become their parents, where grading allows it.
    fn coarsen(&self, py: Python<'_>, mask: PyReadonlyArray1<'_, bool>) -> PyResult<Self> {
        let mask = mask
            .as_slice()
            .map_err(|_| PyValueError::new_err("mask must be contiguous"))?;
        let inner = match &self.inner {
            Mesh::Plane(m) => Mesh::Plane(Arc::new(run(py, || refine::coarsen(m, mask))?)),
            Mesh::Space(m) => Mesh::Space(Arc::new(run(py, || refine::coarsen(m, mask))?)),
        };
        Ok(Self { inner })
    }

    #[getter]
    fn dim(&self) -> usize {
        each!(&self.inner, _m, D => D)
    }

    #[getter]
    fn num_cells(&self) -> usize {
        each!(&self.inner, m => m.num_cells())
    }

    #[getter]
    fn num_functions(&self) -> usize {
        each!(&self.inner, m => m.num_functions())
    }

    #[getter]
    fn num_elements(&self) -> usize {
        each!(&self.inner, m => m.elements().len())
    }

    #[getter]
    fn depth(&self) -> u8 {
        each!(&self.inner, m => m.depth())
    }

    /// Lower corners of the leaves in tree units, (m, d) uint32.
    #[getter]
    fn corners<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<u32>>> {
        each!(&self.inner, m, D => {
            let list: Vec<u32> = m.tree().leaves().iter().flat_map(|l| l.corner).collect();
            list.into_pyarray(py).reshape([m.num_cells(), D])
        })
    }

    /// Levels of the leaves, (m,) uint8.
    #[getter]
    fn levels<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<u8>> {
        each!(&self.inner, m => m.tree().leaves().iter().map(|l| l.level).collect::<Vec<u8>>().into_pyarray(py))
    }

    /// Anchors in tree units, (n, d) uint32; ghosts stand on the vertex that they belong to.
    #[getter]
    fn anchors<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<u32>>> {
        each!(&self.inner, m, D => m.anchors().as_flattened().to_vec().into_pyarray(py).reshape([m.num_functions(), D]))
    }

    /// Local knots in tree units, (n, d, 5) uint32.
    #[getter]
    fn local_knots<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray3<u32>>> {
        each!(&self.inner, m, D => {
            let list: Vec<u32> = m.knots().as_flattened().as_flattened().to_vec();
            list.into_pyarray(py).reshape([m.num_functions(), D, 5])
        })
    }

    /// Leaf at each point, -1 outside.
    fn locate<'py>(&self, py: Python<'py>, at: Points<'py>) -> PyResult<Bound<'py, PyArray1<i64>>> {
        each!(&self.inner, m, D => {
            let xs = points::<D>(&at, "points")?;
            let found = run(py, || {
                let e = m.elements();
                Ok(xs.iter().map(|x| e.locate(m.tree(), x).map_or(-1, |k| e.leaf(k) as i64)).collect::<Vec<i64>>())
            })?;
            Ok(found.into_pyarray(py))
        })
    }

    /// Values, gradients (order >= 1) and Hessians (order 2) at points; outside +inf and NaN.
    fn evaluate<'py>(
        &self,
        py: Python<'py>,
        c: Values<'py>,
        at: Points<'py>,
        order: usize,
    ) -> PyResult<Jets<'py>> {
        let c = values(&c, "coefficients")?;
        each!(&self.inner, m, D => {
            let xs = points::<D>(&at, "points")?;
            let field = run(py, || bulk::evaluate(m, c, xs, order))?;
            jets(py, field, order)
        })
    }

    /// CSR rows of the normalised basis functions: row starts, columns, and one array of entries for each derivative:
    /// the value, then (order >= 1) d/dx_a, then (order 2) d2/dx_a dx_b for a <= b.
    fn basis<'py>(&self, py: Python<'py>, at: Points<'py>, order: usize) -> PyResult<Rows<'py>> {
        each!(&self.inner, m, D => {
            let xs = points::<D>(&at, "points")?;
            let (start, functions, data) = run(py, || {
                let rows = evaluate::basis(m, xs, order);
                let pick = |f: &dyn Fn(&Jet<D>) -> f64| rows.jets.iter().map(f).collect::<Vec<f64>>();
                let mut data = vec![pick(&|j| j.value)];
                if order >= 1 {
                    data.extend((0..D).map(|a| pick(&|j| j.gradient[a])));
                }
                if order >= 2 {
                    data.extend((0..D).flat_map(|a| (a..D).map(move |b| (a, b))).map(|(a, b)| pick(&|j| j.hessian[a][b])));
                }
                Ok((rows.start, rows.functions, data))
            })?;
            let data = data.into_iter().map(|d| d.into_pyarray(py)).collect();
            Ok((start.into_pyarray(py), functions.into_pyarray(py), data))
        })
    }

    /// Closed polylines on the zero set of a planar T-spline: vertices (k, 2) and where each line starts, (l + 1,).
    fn loops<'py>(&self, py: Python<'py>, c: Values<'py>, subdivision: u8) -> PyResult<Lines<'py>> {
        let c = values(&c, "coefficients")?;
        let mesh = plane(&self.inner, "loops")?;
        let loops = run(py, || contour::loops(&mesh, c, subdivision))?;
        lines(py, loops)
    }

    /// Closed triangle mesh on the zero set of a T-spline in space: vertices (n, 3), unit normals (n, 3), triangles (m, 3);
    /// the lattice is `2^subdivision` times as fine as the smallest leaves that the zero set visits.
    fn surface<'py>(&self, py: Python<'py>, c: Values<'py>, subdivision: i8) -> PyResult<Triangles<'py>> {
        let c = values(&c, "coefficients")?;
        let mesh = space(&self.inner, "surface")?;
        let s = run(py, || surface::surface(&mesh, c, subdivision))?;
        triangles(py, s)
    }

    /// Foot points on the zero set from given starts, and whether each was reached.
    fn project<'py>(
        &self,
        py: Python<'py>,
        c: Values<'py>,
        at: Points<'py>,
        starts: Points<'py>,
        max_travel: f64,
    ) -> PyResult<(Bound<'py, PyArray2<f64>>, Bound<'py, PyArray1<bool>>)> {
        let c = values(&c, "coefficients")?;
        each!(&self.inner, m, D => {
            let (xs, from) = (points::<D>(&at, "points")?, points::<D>(&starts, "starts")?);
            if xs.len() != from.len() {
                return Err(PyValueError::new_err("as many starts as points are needed"));
            }
            let (feet, ok) = run(py, || project::project(m, c, xs, from, max_travel))?;
            Ok((table(py, feet)?, ok.into_pyarray(py)))
        })
    }

    /// Raise unless `c` fits the mesh and is finite.
    fn check(&self, c: Values<'_>) -> PyResult<()> {
        let c = values(&c, "coefficients")?;
        each!(&self.inner, m => m.check_coefficients(c).map_err(raise))
    }
}
