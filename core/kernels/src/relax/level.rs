//! Grids from fine to coarse, and what is carried between them.

use std::borrow::Cow;

use rayon::prelude::*;

use super::grid::Grid;
use super::sweep::State;

/// Grids with a side below twice this are not halved.
const COARSEST: usize = 12;

/// A problem on one grid.
pub struct Level<'a, const D: usize> {
    pub grid: Grid<D>,
    pub evidence: Cow<'a, [f32]>,
    pub edges: Cow<'a, [f32]>,
}

impl<const D: usize> Level<'_, D> {
    /// The same problem on half as many pixels an axis, if they are worth it.
    pub fn coarser(&self) -> Option<Self> {
        if self.grid.shape.iter().any(|&s| s < 2 * COARSEST) {
            return None;
        }
        let grid = self.grid.half();
        Some(Self {
            grid,
            evidence: Cow::Owned(halved(&self.grid, &grid, &self.evidence)),
            edges: Cow::Owned(halved(&self.grid, &grid, &self.edges)),
        })
    }

    /// The state that steps of sigma times the edges' weight start from, with shares u (rows, classes, cols) and no dual.
    pub fn state(&self, u: Vec<f32>, sigma: f32) -> State {
        State {
            classes: u.len() / self.grid.len(),
            ahead: vec![0.0; u.len()],
            dual: vec![0.0; u.len() * D],
            tau: self.steps(sigma),
            u,
        }
    }

    /// This coarser level's state on the grid of the level before it.
    pub fn finer(&self, fine: &Self, state: &State, sigma: f32) -> State {
        let (coarse, grid, classes) = (&self.grid, &fine.grid, state.classes);
        let (n, m) = (grid.cols(), coarse.cols());
        let mut next = fine.state(vec![0.0; grid.len() * classes], sigma);
        next.u
            .par_chunks_mut(n)
            .zip(next.dual.par_chunks_mut(n * D))
            .enumerate()
            .for_each(|(k, (u, dual))| {
                let (row, class) = (k / classes, k % classes);
                let from = parent(grid, coarse, row) * classes + class;
                spread(&state.u[from * m..][..m], u);
                for axis in 0..D {
                    let dual = &mut dual[axis * n..][..n];
                    spread(&state.dual[(from * D + axis) * m..][..m], dual);
                    // Nothing flows out of the grid.
                    if axis + 1 < D && grid.after(row, axis).is_none() {
                        dual.fill(0.0);
                    }
                }
                dual[D * n - 1] = 0.0;
            });
        next
    }

    /// Primal steps that go with dual steps of sigma times the edges' weight.
    fn steps(&self, sigma: f32) -> Vec<f32> {
        let (grid, n) = (&self.grid, self.grid.cols());
        let mut tau = vec![0.0; self.edges.len()];
        tau.par_chunks_mut(n).enumerate().for_each(|(row, tau)| {
            let own = &self.edges[row * n..][..n];
            for axis in 0..D {
                let scale = 2.0 * sigma * grid.inverse[axis] * grid.inverse[axis];
                for (t, &e) in tau.iter_mut().zip(own) {
                    *t += scale * e;
                }
                let (back, to) = if axis + 1 == D {
                    (Some(own), &mut tau[1..])
                } else {
                    let back = grid.before(row, axis);
                    (back.map(|r| &self.edges[r * n..][..n]), &mut tau[..])
                };
                for (t, &e) in to.iter_mut().zip(back.unwrap_or(&[])) {
                    *t += scale * e;
                }
            }
            for t in tau {
                // Without length around it a pixel goes at once where its evidence says.
                *t = 1.0 / t.max(1e-20);
            }
        });
        tau
    }

    /// What the best labelling by one class alone could at most be improved by.
    pub fn scale(&self) -> f64 {
        let (grid, evidence) = (&self.grid, &self.evidence);
        let (pixels, classes) = (grid.len(), evidence.len() / grid.len());
        let size = grid.chunk() * grid.cols();
        let parts: Vec<(Vec<f64>, f64, f64)> = (0..pixels.div_ceil(size))
            .into_par_iter()
            .map(|k| {
                let (mut sums, mut best, mut size_of) = (vec![0.0; classes], 0.0, 0.0);
                for j in k * size..pixels.min((k + 1) * size) {
                    let mut top = if classes == 1 { 0.0 } else { f32::NEG_INFINITY };
                    for class in 0..classes {
                        let w = evidence[class * pixels + j];
                        sums[class] += f64::from(w);
                        size_of += f64::from(w.abs());
                        top = top.max(w);
                    }
                    best += f64::from(top);
                }
                (sums, best, size_of)
            })
            .collect();
        let best: f64 = parts.iter().map(|p| p.1).sum();
        let all: f64 = parts.iter().map(|p| p.2).sum();
        let none = if classes == 1 { 0.0 } else { f64::NEG_INFINITY };
        let alone = (0..classes)
            .map(|c| parts.iter().map(|p| p.0[c]).sum())
            .fold(none, f64::max);
        // Where one class has all the evidence nothing is left to gain: rounding then sets the scale.
        (best - alone).max(1e-6 * all)
    }
}

/// Each coarse value twice.
fn spread(coarse: &[f32], fine: &mut [f32]) {
    for (pair, &v) in fine.chunks_mut(2).zip(coarse) {
        pair.fill(v);
    }
}

/// Means over blocks of two pixels an axis, fewer at the far border; of each class.
fn halved<const D: usize>(fine: &Grid<D>, coarse: &Grid<D>, values: &[f32]) -> Vec<f32> {
    let (n, m) = (fine.cols(), coarse.cols());
    let rows = coarse.len() / m;
    let mut out = vec![0.0; values.len() / fine.len() * coarse.len()];
    out.par_chunks_mut(m).enumerate().for_each(|(k, out)| {
        let values = &values[k / rows * fine.len()..][..fine.len()];
        let rows = children(fine, coarse, k % rows);
        let count = rows.iter().flatten().count() as f32;
        for row in rows.into_iter().flatten() {
            for (o, pair) in out.iter_mut().zip(values[row * n..][..n].chunks(2)) {
                *o += pair.iter().sum::<f32>() / pair.len() as f32 / count;
            }
        }
    });
    out
}

/// The coarse row that a fine one lies in.
fn parent<const D: usize>(fine: &Grid<D>, coarse: &Grid<D>, row: usize) -> usize {
    let (mut rest, mut stride, mut out) = (row, 1, 0);
    for axis in (0..D - 1).rev() {
        out += rest % fine.shape[axis] / 2 * stride;
        rest /= fine.shape[axis];
        stride *= coarse.shape[axis];
    }
    out
}

/// The fine rows of a coarse one.
fn children<const D: usize>(fine: &Grid<D>, coarse: &Grid<D>, row: usize) -> [Option<usize>; 4] {
    // In the plane a coarse row has two.
    let mut rows = std::array::from_fn(|k| (k < 1 << (D - 1)).then_some(0));
    let (mut rest, mut stride) = (row, 1);
    for axis in (0..D - 1).rev() {
        let place = rest % coarse.shape[axis];
        rest /= coarse.shape[axis];
        for (k, r) in rows.iter_mut().enumerate() {
            let at = 2 * place + (k >> axis & 1);
            *r = r.filter(|_| at < fine.shape[axis]).map(|r| r + at * stride);
        }
        stride *= fine.shape[axis];
    }
    rows
}
