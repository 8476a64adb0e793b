//! Energies of the two problems: what is reached, and what cannot be beaten.

use multiversion::multiversion;
use rayon::prelude::*;

use super::grid::Grid;
use super::sweep::{after, divergence, Energy, State};

const LANES: usize = 8;

/// Primal energy less dual energy, >= 0; u and the dual must be feasible. Uses `ahead` as a scratch.
pub fn gap<const D: usize>(grid: &Grid<D>, energy: Energy, state: &mut State) -> f64 {
    let (cols, chunk) = (grid.cols(), grid.chunk());
    let (u, dual) = (&state.u, &state.dual);
    let parts: Vec<f64> = state
        .ahead
        .par_chunks_mut(chunk * cols)
        .enumerate()
        .map(|(k, scratch)| gap_rows(grid, energy.evidence, energy.edges, u, dual, scratch, k * chunk))
        .collect();
    parts.iter().sum()
}

#[multiversion(targets("x86_64+avx+avx2"))]
fn gap_rows<const D: usize>(
    grid: &Grid<D>,
    evidence: &[f32],
    edges: &[f32],
    u: &[f32],
    dual: &[f32],
    scratch: &mut [f32],
    first: usize,
) -> f64 {
    let n = grid.cols();
    let mut total = 0.0;
    for (k, out) in scratch.chunks_exact_mut(n).enumerate() {
        let row = first + k;
        divergence(grid, dual, row, out);
        let evidence = &evidence[row * n..][..n];
        let edges = &edges[row * n..][..n];
        let own = &u[row * n..][..n];
        let after = after(grid, u, row);
        for j in 0..n {
            out[j] = (out[j] + evidence[j]).max(0.0) - evidence[j] * own[j];
        }
        for j in 0..n {
            let right = own[if j + 1 < n { j + 1 } else { j }];
            let d = grid.inverse[D - 1] * (right - own[j]);
            let mut square = d * d;
            for axis in 0..D - 1 {
                let d = grid.inverse[axis] * (after[axis][j] - own[j]);
                square += d * d;
            }
            out[j] += edges[j] * square.sqrt();
        }
        total += sum(out);
    }
    total
}

/// Sum in lanes, the same on every processor.
#[inline(always)]
pub fn sum(values: &[f32]) -> f64 {
    let mut lanes = [0.0_f32; LANES];
    let mut whole = values.chunks_exact(LANES);
    for part in &mut whole {
        for k in 0..LANES {
            lanes[k] += part[k];
        }
    }
    let rest: f32 = whole.remainder().iter().sum();
    lanes.iter().map(|&v| f64::from(v)).sum::<f64>() + f64::from(rest)
}
