//! Energies of the two problems: what is reached, and what cannot be beaten.

use multiversion::multiversion;
use rayon::prelude::*;

use super::grid::Grid;
use super::sweep::{after, divergence, Energy, State};

const LANES: usize = 8;

/// Primal energy less dual energy, >= 0; u and the dual must be feasible. Uses `ahead` as a scratch.
pub fn gap<const D: usize>(grid: &Grid<D>, energy: Energy, state: &mut State) -> f64 {
    let (chunk, size) = (grid.chunk(), grid.cols() * state.classes);
    let (u, dual, classes) = (&state.u, &state.dual, state.classes);
    let parts: Vec<f64> = state
        .ahead
        .par_chunks_mut(chunk * size)
        .enumerate()
        .map(|(k, scratch)| gap_rows(grid, classes, energy, u, dual, scratch, k * chunk))
        .collect();
    parts.iter().sum()
}

#[multiversion(targets("x86_64+avx+avx2"))]
fn gap_rows<const D: usize>(
    grid: &Grid<D>,
    classes: usize,
    energy: Energy,
    u: &[f32],
    dual: &[f32],
    scratch: &mut [f32],
    first: usize,
) -> f64 {
    let n = grid.cols();
    let mut total = 0.0;
    for (k, scratch) in scratch.chunks_exact_mut(n * classes).enumerate() {
        let row = first + k;
        let edges = &energy.edges[row * n..][..n];
        let evidence = |class: usize| &energy.evidence[class * grid.len() + row * n..][..n];
        for class in 0..classes {
            let (out, evidence) = (&mut scratch[class * n..][..n], evidence(class));
            divergence(grid, classes, dual, row, class, out);
            for j in 0..n {
                out[j] += evidence[j];
            }
        }
        // What the best labelling of each pixel by itself makes of the dual; nothing is the other of one class.
        let (best, others) = scratch.split_at_mut(n);
        if classes == 1 {
            for b in best.iter_mut() {
                *b = b.max(0.0);
            }
        }
        for other in others.chunks_exact(n) {
            for (b, &o) in best.iter_mut().zip(other) {
                *b = b.max(o);
            }
        }
        for class in 0..classes {
            let evidence = evidence(class);
            let after = after(grid, classes, u, row, class);
            let own = after[D - 1];
            for j in 0..n {
                let right = own[if j + 1 < n { j + 1 } else { j }];
                let d = grid.inverse[D - 1] * (right - own[j]);
                let mut square = d * d;
                for axis in 0..D - 1 {
                    let d = grid.inverse[axis] * (after[axis][j] - own[j]);
                    square += d * d;
                }
                best[j] += edges[j] * square.sqrt() - evidence[j] * own[j];
            }
        }
        total += sum(best);
    }
    total
}

/// Sum in lanes, the same on every processor.
#[inline(always)]
fn sum(values: &[f32]) -> f64 {
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
