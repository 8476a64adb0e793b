//! Least-squares rows of points on a lattice, applied without ever forming their matrix.
//!
//! A point asks for a value, a (f(x) - t)^2, and for a gradient, b (|n . grad f - u|^2 + s |P grad f|^2) with P the
//! projection along the unit normal n. Points are sorted by cell; cells are cut into slabs of four along the first axis.
//! Slabs of even number write to disjoint nodes and run in parallel, then those of odd number: every node receives its
//! sums in one order, whatever the number of threads.

use multiversion::multiversion;
use rayon::prelude::*;

use crate::error::{KernelError, Result};
use crate::lattice::Lattice;

/// Cells of a slab along the first axis; nodes of every other slab are disjoint from 3 cells on.
const SLAB: u32 = 4;

/// What one point asks for.
#[derive(Debug, Clone, Copy)]
pub struct Target {
    /// Weight of the value and the value.
    pub weight: f64,
    pub value: f64,
    /// Weight of the gradient, the unit normal, and the slope u along it.
    pub normal_weight: f64,
    pub normal: [f64; 3],
    pub slope: f64,
}

/// A row: four values and four slopes of the basis on each axis.
#[derive(Debug, Clone, Copy)]
struct Row {
    value: [[f64; 4]; 3],
    slope: [[f64; 4]; 3],
    target: Target,
    cell: u32,
}

/// The rows of one slab, and the range of nodes that they touch.
#[derive(Debug, Clone, Copy)]
struct Slab {
    number: u32,
    rows: (usize, usize),
    nodes: (usize, usize),
}

/// The rows of a set of points on one lattice.
#[derive(Debug, Clone)]
pub struct Rows {
    every: Vec<Row>,
    cells: Vec<[u32; 16]>,
    slabs: Vec<Slab>,
    tangential: f64,
}

/// Values of the four cubic B-splines on a cell at place t of it.
#[inline]
pub fn values(t: f64) -> [f64; 4] {
    let s = 1.0 - t;
    [
        s * s * s / 6.0,
        (3.0 * t * t * t - 6.0 * t * t + 4.0) / 6.0,
        (3.0 * s * s * s - 6.0 * s * s + 4.0) / 6.0,
        t * t * t / 6.0,
    ]
}

/// Their derivatives with respect to t.
#[inline]
pub fn slopes(t: f64) -> [f64; 4] {
    let s = 1.0 - t;
    [
        -0.5 * s * s,
        (3.0 * t * t - 4.0 * t) / 2.0,
        (4.0 * s - 3.0 * s * s) / 2.0,
        0.5 * t * t,
    ]
}

/// Their second derivatives.
#[inline]
pub fn bends(t: f64) -> [f64; 4] {
    [1.0 - t, 3.0 * t - 2.0, 1.0 - 3.0 * t, t]
}

impl Rows {
    /// Rows of `points` (in the unit box) for `targets`; `tangential` is s.
    pub fn new(lattice: &Lattice, points: &[[f64; 3]], targets: &[Target], tangential: f64) -> Result<Self> {
        let n = f64::from(1u32 << lattice.level());
        let mut order: Vec<([u32; 3], u32)> = points
            .par_iter()
            .enumerate()
            .map(|(p, x)| (lattice.locate(x).0, p as u32))
            .collect();
        order.par_sort_unstable();
        let mut cells: Vec<[u32; 16]> = Vec::new();
        let mut of_row = Vec::with_capacity(order.len());
        let mut slabs: Vec<Slab> = Vec::new();
        let mut last = None;
        for (row, &(cell, _)) in order.iter().enumerate() {
            if last != Some(cell) {
                let base = lattice.cell(cell).ok_or_else(|| {
                    KernelError::Invalid("points: a point outside of the lattice's cells".into())
                })?;
                let nodes = (base[0] as usize, base[15] as usize + 4);
                let number = cell[0] / SLAB;
                match slabs.last_mut() {
                    Some(slab) if slab.number == number => {
                        slab.nodes = (slab.nodes.0.min(nodes.0), slab.nodes.1.max(nodes.1));
                    }
                    _ => slabs.push(Slab {
                        number,
                        rows: (row, row),
                        nodes,
                    }),
                }
                cells.push(base);
                last = Some(cell);
            }
            if let Some(slab) = slabs.last_mut() {
                slab.rows.1 = row + 1;
            }
            of_row.push(cells.len() as u32 - 1);
        }
        let rows = order
            .par_iter()
            .zip(&of_row)
            .map(|(&(_, p), &cell)| {
                let (_, t) = lattice.locate(&points[p as usize]);
                Row {
                    value: t.map(values),
                    slope: t.map(|t| slopes(t).map(|v| n * v)),
                    target: targets[p as usize],
                    cell,
                }
            })
            .collect();
        Ok(Self {
            every: rows,
            cells,
            slabs,
            tangential,
        })
    }

    /// y += A x for the rows' normal matrix A = sum of the squares above.
    pub fn multiply(&self, x: &[f64], y: &mut [f64]) {
        self.scatter(y, |rows, y, first| multiply_rows(self, rows, x, y, first));
    }

    /// y -= the gradient of half the energy at coefficients x.
    pub fn residual(&self, x: &[f64], y: &mut [f64]) {
        self.scatter(y, |rows, y, first| {
            for row in rows {
                let base = &self.cells[row.cell as usize];
                let (pull, force) = self.forces(row, gather(row, base, x), 1.0);
                spread(row, base, first, -pull, force.map(|f| -f), y);
            }
        });
    }

    /// y += the diagonal of A.
    pub fn diagonal(&self, y: &mut [f64]) {
        self.scatter(y, |rows, y, first| {
            for row in rows {
                let base = &self.cells[row.cell as usize];
                for q in 0..16 {
                    let (i, j) = (q / 4, q % 4);
                    let v2 = |a: usize, m: usize| row.value[a][m];
                    for k in 0..4 {
                        let b = v2(0, i) * v2(1, j) * v2(2, k);
                        let g = [
                            row.slope[0][i] * v2(1, j) * v2(2, k),
                            v2(0, i) * row.slope[1][j] * v2(2, k),
                            v2(0, i) * v2(1, j) * row.slope[2][k],
                        ];
                        let t = &row.target;
                        let along: f64 = (0..3).map(|a| g[a] * t.normal[a]).sum();
                        let all: f64 = g.iter().map(|g| g * g).sum();
                        let gradient = (1.0 - self.tangential) * along * along + self.tangential * all;
                        y[base[q] as usize - first + k] += t.weight * b * b + t.normal_weight * gradient;
                    }
                }
            }
        });
    }

    /// Weighted value and gradient that a row's residual puts back; `given` = 1 subtracts what is asked for.
    #[inline(always)]
    fn forces(&self, row: &Row, (value, gradient): (f64, [f64; 3]), given: f64) -> (f64, [f64; 3]) {
        let t = &row.target;
        let pull = t.weight * (value - given * t.value);
        let along = (0..3).map(|a| gradient[a] * t.normal[a]).sum::<f64>();
        let normal = t.normal_weight * ((1.0 - self.tangential) * along - given * t.slope);
        let rest = t.normal_weight * self.tangential;
        (
            pull,
            std::array::from_fn(|a| normal * t.normal[a] + rest * gradient[a]),
        )
    }

    /// Run `work` on every slab: its rows, its part of y, and the number of that part's first node.
    fn scatter(&self, y: &mut [f64], work: impl Fn(&[Row], &mut [f64], usize) + Sync) {
        for parity in 0..2 {
            let mut parts = Vec::new();
            let (mut rest, mut at) = (&mut *y, 0);
            for slab in self.slabs.iter().filter(|slab| slab.number % 2 == parity) {
                let (_, tail) = rest.split_at_mut(slab.nodes.0 - at);
                let (own, tail) = tail.split_at_mut(slab.nodes.1 - slab.nodes.0);
                parts.push((slab, own));
                rest = tail;
                at = slab.nodes.1;
            }
            parts
                .into_par_iter()
                .for_each(|(slab, own)| work(&self.every[slab.rows.0..slab.rows.1], own, slab.nodes.0));
        }
    }
}

/// y += A x for some rows; compiled for several generations of processors, with the same bits on all.
#[multiversion(targets("x86_64+avx+avx2"))]
fn multiply_rows(all: &Rows, rows: &[Row], x: &[f64], y: &mut [f64], first: usize) {
    for row in rows {
        let base = &all.cells[row.cell as usize];
        let (pull, force) = all.forces(row, gather(row, base, x), 0.0);
        spread(row, base, first, pull, force, y);
    }
}

/// Value and gradient at a row's point.
#[inline(always)]
fn gather(row: &Row, base: &[u32; 16], x: &[f64]) -> (f64, [f64; 3]) {
    let [vi, vj, vk] = &row.value;
    let [gi, gj, gk] = &row.slope;
    let (mut value, mut gradient) = (0.0, [0.0; 3]);
    for i in 0..4 {
        let (mut plain, mut by_j, mut by_k) = (0.0, 0.0, 0.0);
        for j in 0..4 {
            let at = base[4 * i + j] as usize;
            let c = &x[at..at + 4];
            let v = (c[0] * vk[0] + c[1] * vk[1]) + (c[2] * vk[2] + c[3] * vk[3]);
            let g = (c[0] * gk[0] + c[1] * gk[1]) + (c[2] * gk[2] + c[3] * gk[3]);
            plain += vj[j] * v;
            by_j += gj[j] * v;
            by_k += vj[j] * g;
        }
        value += vi[i] * plain;
        gradient[0] += gi[i] * plain;
        gradient[1] += vi[i] * by_j;
        gradient[2] += vi[i] * by_k;
    }
    (value, gradient)
}

/// Add `pull` times the value and `force` times the gradient of the basis at a row's point.
#[inline(always)]
fn spread(row: &Row, base: &[u32; 16], first: usize, pull: f64, force: [f64; 3], y: &mut [f64]) {
    let [vi, vj, vk] = &row.value;
    let [gi, gj, gk] = &row.slope;
    for i in 0..4 {
        let here = pull * vi[i] + force[0] * gi[i];
        for j in 0..4 {
            let flat = here * vj[j] + force[1] * vi[i] * gj[j];
            let steep = force[2] * vi[i] * vj[j];
            let at = base[4 * i + j] as usize - first;
            let out = &mut y[at..at + 4];
            for k in 0..4 {
                out[k] += flat * vk[k] + steep * gk[k];
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn slopes_and_bends_are_derivatives() {
        for t in [0.0, 0.3, 0.75, 1.0] {
            let (v, g, h) = (values(t), slopes(t), bends(t));
            assert!((v.iter().sum::<f64>() - 1.0).abs() < 1e-15);
            assert!(g.iter().sum::<f64>().abs() < 1e-15 && h.iter().sum::<f64>().abs() < 1e-15);
            // sum (q - 1) B_q = t: the functions stand at -1, 0, 1, 2.
            let at = |w: [f64; 4]| (0..4).map(|q| w[q] * (q as f64 - 1.0)).sum::<f64>();
            assert!((at(v) - t).abs() < 1e-15 && (at(g) - 1.0).abs() < 1e-15 && at(h).abs() < 1e-15);
            for q in 0..4 {
                // Central differences of cubics are off by a sixth of the third derivative, 3 at most.
                let d = 1e-5;
                assert!(((values(t + d)[q] - values(t - d)[q]) / (2.0 * d) - g[q]).abs() < 1e-9);
                assert!(((slopes(t + d)[q] - slopes(t - d)[q]) / (2.0 * d) - h[q]).abs() < 1e-9);
            }
        }
    }

    #[test]
    fn the_matrix_its_diagonal_and_the_residual_agree() {
        let lattice = Lattice::new(3, &[[0, 1, 2], [4, 4, 4], [5, 1, 7]]).unwrap();
        let cells = [
            [0.05, 0.2, 0.3],
            [0.55, 0.6, 0.5],
            [0.7, 0.13, 0.99],
            [0.56, 0.51, 0.62],
        ];
        let targets: Vec<Target> = (0..4)
            .map(|q| Target {
                weight: 1.0 + f64::from(q),
                value: 0.3 - f64::from(q),
                normal_weight: 0.2,
                normal: [0.6, 0.0, 0.8],
                slope: 1.5,
            })
            .collect();
        let rows = Rows::new(&lattice, &cells, &targets, 0.4).unwrap();
        let size = lattice.len();
        let times = |x: &[f64]| {
            let mut y = vec![0.0; size];
            rows.multiply(x, &mut y);
            y
        };
        let left = |x: &[f64]| {
            let mut y = vec![0.0; size];
            rows.residual(x, &mut y);
            y
        };
        let x: Vec<f64> = (0..size).map(|q| (q as f64).sin()).collect();
        let (ax, r0, rx) = (times(&x), left(&vec![0.0; size]), left(&x));
        for q in 0..size {
            assert!((r0[q] - rx[q] - ax[q]).abs() < 1e-11);
        }
        let mut diagonal = vec![0.0; size];
        rows.diagonal(&mut diagonal);
        for q in (0..size).step_by(7) {
            let mut unit = vec![0.0; size];
            unit[q] = 1.0;
            assert!((times(&unit)[q] - diagonal[q]).abs() < 1e-12 * (1.0 + diagonal[q]));
        }
    }

    #[test]
    fn points_that_no_cell_holds_are_refused() {
        let lattice = Lattice::new(4, &[[0, 0, 0]]).unwrap();
        let target = Target {
            weight: 1.0,
            value: 0.0,
            normal_weight: 0.0,
            normal: [0.0; 3],
            slope: 1.0,
        };
        assert!(Rows::new(&lattice, &[[0.9, 0.0, 0.0]], &[target], 0.0).is_err());
    }
}
