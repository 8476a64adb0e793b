//! Labelling of two regions by convex relaxation: minimise sum edges |grad u| - evidence u over u in [0, 1].
//!
//! Almost every level of a minimiser bounds a best region (Chan, Esedoglu and Nikolova, SIAM J. Appl. Math. 66, 2006).
//! The primal-dual method of Chambolle and Pock with their diagonal steps (ICCV 2011), over-relaxed, from coarse grids to
//! the fine one: flat places then start with what the coarse grid found. Every pixel is treated alike, so that the bits
//! do not depend on how the rows are shared out.

mod bound;
mod grid;
mod sweep;

use std::borrow::Cow;

use rayon::prelude::*;

use crate::error::{KernelError, Result};
use grid::Grid;
use sweep::{Energy, State, Step};

/// Steps between looks at the gap.
const LOOK: usize = 10;
/// Grids with a side below this are not halved.
const COARSEST: usize = 12;

/// Dual steps in units of edges times the pixel's smaller side, and over-relaxation: fastest on grey images and volumes,
/// little worse at half and at twice as much.
const SIGMA: f32 = 0.6;
const RELAXATION: f32 = 1.8;

struct Level<'a, const D: usize> {
    grid: Grid<D>,
    evidence: Cow<'a, [f32]>,
    edges: Cow<'a, [f32]>,
}

/// A relaxation under way.
pub struct Relaxation<'a, const D: usize> {
    /// Coarsest last; those that are done are dropped.
    levels: Vec<Level<'a, D>>,
    state: State,
    step: Step,
    steps: usize,
    done_here: usize,
    gap: f64,
    scale: f64,
    max_steps: usize,
    tolerance: f64,
}

impl<'a, const D: usize> Relaxation<'a, D> {
    /// Starts from `start`, or from coarser grids.
    pub fn new(
        evidence: &'a [f32],
        edges: &'a [f32],
        shape: [usize; D],
        spacing: [f64; D],
        start: Option<&[f32]>,
        max_steps: usize,
        tolerance: f64,
    ) -> Result<Self> {
        let grid = Grid {
            shape,
            inverse: spacing.map(|h| 1.0 / h as f32),
        };
        let n = grid.len();
        if n == 0 || evidence.len() != n || edges.len() != n || start.is_some_and(|s| s.len() != n) {
            return Err(KernelError::Invalid(
                "arrays of one shape, not empty, are needed".into(),
            ));
        }
        if !spacing.iter().all(|&h| h > 0.0 && h.is_finite()) {
            return Err(KernelError::Invalid(
                "spacing: positive lengths are needed".into(),
            ));
        }
        if !evidence.par_iter().all(|w| w.is_finite()) {
            return Err(KernelError::Invalid("evidence: finite numbers are needed".into()));
        }
        if !edges.par_iter().all(|&e| e >= 0.0 && e.is_finite()) {
            return Err(KernelError::Invalid(
                "edges: finite numbers >= 0 are needed".into(),
            ));
        }
        let mut levels = vec![Level {
            grid,
            evidence: Cow::Borrowed(evidence),
            edges: Cow::Borrowed(edges),
        }];
        if start.is_none() {
            while let Some(last) = levels
                .last()
                .filter(|l| l.grid.shape.iter().all(|&s| s >= 2 * COARSEST))
            {
                let grid = last.grid.half();
                let next = Level {
                    grid,
                    evidence: Cow::Owned(halved(&last.grid, &grid, &last.evidence)),
                    edges: Cow::Owned(halved(&last.grid, &grid, &last.edges)),
                };
                levels.push(next);
            }
        }
        let least = spacing.iter().copied().fold(f64::INFINITY, f64::min) as f32;
        let depth = levels.len();
        let mut this = Self {
            levels,
            state: State {
                u: vec![],
                ahead: vec![],
                dual: vec![],
                tau: vec![],
            },
            step: Step {
                sigma: SIGMA * least * (1 << (depth - 1)) as f32,
                relaxation: RELAXATION,
            },
            steps: 0,
            done_here: 0,
            gap: f64::INFINITY,
            scale: 0.0,
            max_steps,
            tolerance,
        };
        let level = &this.levels[this.levels.len() - 1];
        let n = level.grid.len();
        this.state = State {
            u: match start {
                Some(start) => start.iter().map(|v| v.clamp(0.0, 1.0)).collect(),
                None => level
                    .evidence
                    .iter()
                    .map(|&w| if w > 0.0 { 1.0 } else { 0.0 })
                    .collect(),
            },
            ahead: vec![0.0; n],
            dual: vec![0.0; n * D],
            tau: vec![],
        };
        this.enter();
        if start.is_some() {
            let level = &this.levels[0];
            sweep::align(&level.grid, &level.edges, &mut this.state);
        }
        Ok(this)
    }

    /// Prepare the level that comes next.
    fn enter(&mut self) {
        let level = self.levels.last().expect("a level is left");
        self.state.tau = steps(&level.grid, &level.edges, self.step.sigma);
        let (gain, loss) = trivial(&level.grid, &level.evidence);
        // One-sided evidence leaves nothing to gain: rounding then sets the scale.
        self.scale = gain.min(loss).max(1e-6 * (gain + loss));
        self.done_here = 0;
        self.gap = f64::INFINITY;
    }

    /// Some steps; whether all is done.
    pub fn advance(&mut self, steps: usize) -> bool {
        for _ in 0..steps {
            let level = self.levels.last().expect("a level is left");
            let energy = Energy {
                evidence: &level.evidence,
                edges: &level.edges,
            };
            self.done_here += 1;
            let look = self.done_here % LOOK == 0 || self.done_here >= self.max_steps;
            // A plain step ends on feasible values.
            let step = Step {
                relaxation: if look { 1.0 } else { self.step.relaxation },
                ..self.step
            };
            sweep::advance(&level.grid, energy, &mut self.state, &step);
            self.steps += 1;
            if !look {
                continue;
            }
            self.gap = bound::gap(&level.grid, energy, &mut self.state).max(0.0);
            if self.gap > self.tolerance * self.scale && self.done_here < self.max_steps {
                continue;
            }
            if self.levels.len() == 1 {
                return true;
            }
            let coarse = self.levels.pop().expect("there are two");
            let fine = &self.levels[self.levels.len() - 1];
            let (u, dual) = finer(&coarse.grid, &fine.grid, &self.state);
            self.state.ahead = vec![0.0; u.len()];
            self.state.u = u;
            self.state.dual = dual;
            self.step.sigma *= 0.5;
            self.enter();
        }
        false
    }

    /// u, the number of steps on all grids, and the gap relative to what the better empty labelling can be improved by.
    pub fn finish(self) -> (Vec<f32>, usize, f64) {
        let gap = if self.scale > 0.0 {
            self.gap / self.scale
        } else {
            0.0
        };
        (self.state.u, self.steps, gap)
    }
}

/// Sums of the evidence for the object and, positive, against it.
fn trivial<const D: usize>(grid: &Grid<D>, evidence: &[f32]) -> (f64, f64) {
    let parts: Vec<(f64, f64)> = evidence
        .par_chunks(grid.chunk() * grid.cols())
        .map(|w| {
            w.iter().fold((0.0, 0.0), |(a, b), &w| {
                (a + f64::from(w.max(0.0)), b + f64::from((-w).max(0.0)))
            })
        })
        .collect();
    parts.iter().fold((0.0, 0.0), |(a, b), p| (a + p.0, b + p.1))
}

/// Primal steps that go with dual steps of sigma times the edges' weight.
fn steps<const D: usize>(grid: &Grid<D>, edges: &[f32], sigma: f32) -> Vec<f32> {
    let n = grid.cols();
    let mut tau = vec![0.0; edges.len()];
    tau.par_chunks_mut(n).enumerate().for_each(|(row, tau)| {
        let own = &edges[row * n..][..n];
        for axis in 0..D {
            let scale = 2.0 * sigma * grid.inverse[axis] * grid.inverse[axis];
            if axis + 1 == D {
                for j in 0..n {
                    let back = if j > 0 { own[j - 1] } else { 0.0 };
                    tau[j] += scale * (own[j] + back);
                }
            } else {
                let back = grid.before(row, axis).map(|r| &edges[r * n..][..n]);
                for j in 0..n {
                    tau[j] += scale * (own[j] + back.map_or(0.0, |b| b[j]));
                }
            }
        }
        for t in tau {
            *t = 1.0 / t.max(1e-20);
        }
    });
    tau
}

/// Means over blocks of two pixels an axis, fewer at the far border.
fn halved<const D: usize>(fine: &Grid<D>, coarse: &Grid<D>, values: &[f32]) -> Vec<f32> {
    let (n, m) = (fine.cols(), coarse.cols());
    let mut out = vec![0.0; coarse.len()];
    out.par_chunks_mut(m).enumerate().for_each(|(row, out)| {
        let rows = children(fine, coarse, row);
        let count = rows.iter().flatten().count() as f32;
        for row in rows.into_iter().flatten() {
            let own = &values[row * n..][..n];
            for (o, pair) in out.iter_mut().zip(own.chunks(2)) {
                *o += pair.iter().sum::<f32>() / pair.len() as f32 / count;
            }
        }
    });
    out
}

/// The fine rows of a coarse row.
fn children<const D: usize>(fine: &Grid<D>, coarse: &Grid<D>, row: usize) -> [Option<usize>; 4] {
    let mut rows = [Some(0); 4];
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
    // Of a row alone the pairs would come twice.
    if D == 2 {
        rows[2] = None;
        rows[3] = None;
    }
    rows
}

/// The coarse u and dual on the fine grid.
fn finer<const D: usize>(coarse: &Grid<D>, fine: &Grid<D>, state: &State) -> (Vec<f32>, Vec<f32>) {
    let (n, m) = (fine.cols(), coarse.cols());
    let mut u = vec![0.0; fine.len()];
    let mut dual = vec![0.0; fine.len() * D];
    let parent = |row: usize| {
        let (mut rest, mut stride, mut out) = (row, 1, 0);
        for axis in (0..D - 1).rev() {
            out += rest % fine.shape[axis] / 2 * stride;
            rest /= fine.shape[axis];
            stride *= coarse.shape[axis];
        }
        out
    };
    u.par_chunks_mut(n)
        .zip(dual.par_chunks_mut(n * D))
        .enumerate()
        .for_each(|(row, (u, dual))| {
            let from = parent(row);
            let own = &state.u[from * m..][..m];
            for (pair, &v) in u.chunks_mut(2).zip(own) {
                pair.fill(v);
            }
            for axis in 0..D {
                let own = &state.dual[(from * D + axis) * m..][..m];
                for (pair, &v) in dual[axis * n..][..n].chunks_mut(2).zip(own) {
                    pair.fill(v);
                }
            }
            // Nothing flows out of the grid.
            for axis in 0..D - 1 {
                if fine.after(row, axis).is_none() {
                    dual[axis * n..][..n].fill(0.0);
                }
            }
            dual[D * n - 1] = 0.0;
        });
    (u, dual)
}
