//! Labelling by convex relaxation: minimise the sum over classes of edges |grad u| - evidence u over shares u.
//!
//! One class against the rest: u in [0, 1], almost every level of a minimiser bounds a best region (Chan, Esedoglu and
//! Nikolova, SIAM J. Appl. Math. 66, 2006). Several: shares that add up to 1, each border counted half for either class
//! (Zach, Gallup, Frahm and Niethammer, VMV 2008). By the primal-dual method of Chambolle and Pock with diagonal steps
//! (ICCV 2011), over-relaxed, from coarse grids to the fine one: flat places then start with what the coarse grid found.
//! Every pixel is treated alike, so that the bits do not depend on how the rows are shared out.

mod bound;
mod grid;
mod level;
mod simplex;
mod sweep;

use std::borrow::Cow;

use rayon::prelude::*;

use crate::error::{KernelError, Result};
use grid::Grid;
use level::Level;
use sweep::{Energy, State, Step};

/// Steps between looks at the gap.
const LOOK: usize = 10;
/// Dual steps in units of edges times the pixel's smaller side, and over-relaxation: fastest on grey images and volumes,
/// little worse at half and at twice as much.
const SIGMA: f32 = 0.6;
const RELAXATION: f32 = 1.8;

/// When to stop.
#[derive(Debug, Clone, Copy)]
pub struct Limits {
    /// Steps on each grid.
    pub max_steps: usize,
    /// Duality gap, relative to what the best labelling by one class alone could at most be improved by.
    pub tolerance: f64,
}

/// A relaxation under way.
pub struct Relaxation<'a, const D: usize> {
    /// Coarsest last; those that are done are dropped.
    levels: Vec<Level<'a, D>>,
    state: State,
    step: Step,
    limits: Limits,
    /// On all grids, and on this one.
    steps: usize,
    steps_here: usize,
    gap: f64,
    scale: f64,
}

impl<'a, const D: usize> Relaxation<'a, D> {
    /// Evidence (classes, shape), of one class for it against the rest. Starts from `start`, like the evidence, or from
    /// coarser grids.
    pub fn new(
        evidence: &'a [f32],
        edges: &'a [f32],
        shape: [usize; D],
        spacing: [f64; D],
        start: Option<&[f32]>,
        limits: Limits,
    ) -> Result<Self> {
        let grid = Grid {
            shape,
            inverse: spacing.map(|h| 1.0 / h as f32),
        };
        check(&grid, evidence, edges, &spacing, start)?;
        let classes = evidence.len() / grid.len();
        let edges = if classes == 1 {
            Cow::Borrowed(edges)
        } else {
            // Each border is counted by the two classes that it parts.
            Cow::Owned(edges.par_iter().map(|e| 0.5 * e).collect())
        };
        let mut levels = vec![Level {
            grid,
            evidence: Cow::Borrowed(evidence),
            edges,
        }];
        while let Some(next) = levels.last().filter(|_| start.is_none()).and_then(Level::coarser) {
            levels.push(next);
        }
        let least = spacing.iter().copied().fold(f64::INFINITY, f64::min) as f32;
        let step = Step {
            sigma: SIGMA * least * (1_u32 << (levels.len() - 1)) as f32,
            relaxation: RELAXATION,
        };
        let coarsest = &levels[levels.len() - 1];
        let u = match start {
            Some(start) => by_row(&grid, start),
            None => by_row(&coarsest.grid, &labels(&coarsest.grid, &coarsest.evidence)),
        };
        let mut state = coarsest.state(u, step.sigma);
        if start.is_some() {
            sweep::align(&grid, &coarsest.edges, &mut state);
        }
        Ok(Self {
            scale: coarsest.scale(),
            levels,
            state,
            step,
            limits,
            steps: 0,
            steps_here: 0,
            gap: f64::INFINITY,
        })
    }

    /// Some steps; whether all is done.
    pub fn advance(&mut self, steps: usize) -> bool {
        for _ in 0..steps {
            if self.step() {
                if self.levels.len() == 1 {
                    return true;
                }
                self.refine();
            }
        }
        false
    }

    /// One step; whether this grid is done.
    fn step(&mut self) -> bool {
        let level = &self.levels[self.levels.len() - 1];
        let energy = Energy {
            evidence: &level.evidence,
            edges: &level.edges,
        };
        self.steps += 1;
        self.steps_here += 1;
        let last = self.steps_here >= self.limits.max_steps;
        if !last && self.steps_here % LOOK != 0 {
            sweep::advance(&level.grid, energy, &mut self.state, self.step);
            return false;
        }
        // A plain step ends on feasible values.
        let plain = Step {
            relaxation: 1.0,
            ..self.step
        };
        sweep::advance(&level.grid, energy, &mut self.state, plain);
        // Rounding can take it below 0.
        self.gap = bound::gap(&level.grid, energy, &mut self.state).max(0.0);
        last || self.gap <= self.limits.tolerance * self.scale
    }

    /// Go on with the next finer grid.
    fn refine(&mut self) {
        if let Some(coarse) = self.levels.pop() {
            let fine = &self.levels[self.levels.len() - 1];
            self.step.sigma *= 0.5;
            self.state = coarse.finer(fine, &self.state, self.step.sigma);
            self.scale = fine.scale();
            self.steps_here = 0;
        }
    }

    /// Shares (classes, shape), the number of steps on all grids, and the relative gap.
    pub fn finish(self) -> (Vec<f32>, usize, f64) {
        let gap = if self.gap > 0.0 {
            self.gap / self.scale
        } else {
            0.0
        };
        (by_class(&self.levels[0].grid, self.state.u), self.steps, gap)
    }
}

fn check<const D: usize>(
    grid: &Grid<D>,
    evidence: &[f32],
    edges: &[f32],
    spacing: &[f64; D],
    start: Option<&[f32]>,
) -> Result<()> {
    let refuse = |text: &str| Err(KernelError::Invalid(text.into()));
    let n = grid.len();
    if n == 0 || evidence.is_empty() || evidence.len() % n != 0 || edges.len() != n {
        return refuse("evidence, edges: arrays of one shape, not empty, are needed");
    }
    if start.is_some_and(|s| s.len() != evidence.len() || s.iter().any(|v| !v.is_finite())) {
        return refuse("start: as many finite numbers as of evidence are needed");
    }
    if !spacing.iter().all(|&h| h > 0.0 && h.is_finite()) {
        return refuse("spacing: positive lengths are needed");
    }
    if !evidence.par_iter().all(|w| w.is_finite()) {
        return refuse("evidence: finite numbers are needed");
    }
    if !edges.par_iter().all(|&e| e >= 0.0 && e.is_finite()) {
        return refuse("edges: finite numbers >= 0 are needed");
    }
    Ok(())
}

/// Shares of 0 and 1: of each pixel the class with the most evidence.
fn labels<const D: usize>(grid: &Grid<D>, evidence: &[f32]) -> Vec<f32> {
    let n = grid.len();
    if evidence.len() == n {
        return evidence.iter().map(|&w| f32::from(u8::from(w > 0.0))).collect();
    }
    let mut shares = vec![0.0; evidence.len()];
    for j in 0..n {
        let classes = 0..evidence.len() / n;
        // The first of equals.
        let best = classes
            .rev()
            .max_by(|&a, &b| evidence[a * n + j].total_cmp(&evidence[b * n + j]));
        shares[best.unwrap_or(0) * n + j] = 1.0;
    }
    shares
}

/// (classes, rows, cols) as (rows, classes, cols).
fn by_row<const D: usize>(grid: &Grid<D>, shares: &[f32]) -> Vec<f32> {
    transposed(shares, shares.len() / grid.len(), grid.cols())
}

/// (rows, classes, cols) as (classes, rows, cols).
fn by_class<const D: usize>(grid: &Grid<D>, shares: Vec<f32>) -> Vec<f32> {
    if shares.len() == grid.len() {
        return shares;
    }
    transposed(&shares, grid.len() / grid.cols(), grid.cols())
}

/// (a, b, cols) as (b, a, cols), clipped to [0, 1].
fn transposed(values: &[f32], a: usize, n: usize) -> Vec<f32> {
    let b = values.len() / a / n;
    let mut out = Vec::with_capacity(values.len());
    for j in 0..b {
        for i in 0..a {
            out.extend(values[(i * b + j) * n..][..n].iter().map(|v| v.clamp(0.0, 1.0)));
        }
    }
    out
}
