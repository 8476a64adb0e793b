//! Conjugate gradients with a diagonal preconditioner, on all threads, with the same bits for any number of them.

use rayon::prelude::*;

/// Entries of a chunk: sums over chunks are added in order.
const CHUNK: usize = 4096;

/// x with A x = r, the preconditioned norm of r reduced by `tolerance`; iterations, and whether that was reached.
///
/// `inverse` is the inverse of A's diagonal (0: an unknown that stays 0); `multiply(p, q)` sets q = A p.
pub fn conjugate_gradients(
    multiply: impl Fn(&[f64], &mut [f64]),
    mut r: Vec<f64>,
    inverse: &[f64],
    tolerance: f64,
    max_iterations: usize,
) -> (Vec<f64>, usize, bool) {
    let mut x = vec![0.0; r.len()];
    let mut q = vec![0.0; r.len()];
    let mut p: Vec<f64> = r.iter().zip(inverse).map(|(r, i)| r * i).collect();
    let mut old = dot(&r, &p);
    let goal = tolerance * tolerance * old;
    for iteration in 0..max_iterations {
        if old.is_nan() || old <= goal || old == 0.0 {
            return (x, iteration, !old.is_nan());
        }
        multiply(&p, &mut q);
        let curvature = dot(&p, &q);
        if curvature <= 0.0 {
            return (x, iteration, false);
        }
        let step = old / curvature;
        add(&mut x, step, &p);
        add(&mut r, -step, &q);
        let new = weighted(&r, inverse);
        let beta = new / old;
        p.par_iter_mut()
            .zip(r.par_iter().zip(inverse))
            .with_min_len(CHUNK)
            .for_each(|(p, (r, i))| *p = r * i + beta * *p);
        old = new;
    }
    (x, max_iterations, old <= goal)
}

fn add(y: &mut [f64], factor: f64, x: &[f64]) {
    y.par_iter_mut()
        .zip(x)
        .with_min_len(CHUNK)
        .for_each(|(y, x)| *y += factor * x);
}

fn dot(a: &[f64], b: &[f64]) -> f64 {
    let parts: Vec<f64> = a
        .par_chunks(CHUNK)
        .zip(b.par_chunks(CHUNK))
        .map(|(a, b)| a.iter().zip(b).map(|(a, b)| a * b).sum())
        .collect();
    parts.iter().sum()
}

fn weighted(r: &[f64], inverse: &[f64]) -> f64 {
    let parts: Vec<f64> = r
        .par_chunks(CHUNK)
        .zip(inverse.par_chunks(CHUNK))
        .map(|(r, i)| r.iter().zip(i).map(|(r, i)| r * r * i).sum())
        .collect();
    parts.iter().sum()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Second differences with ends held.
    fn chain(p: &[f64], q: &mut [f64]) {
        let at = |k: usize| p.get(k).copied().unwrap_or(0.0);
        for k in 0..p.len() {
            q[k] = 2.0 * p[k] - at(k + 1) - at(k.wrapping_sub(1));
        }
    }

    #[test]
    fn a_chain_under_its_weight_hangs_in_a_parabola() {
        let (x, iterations, converged) = conjugate_gradients(chain, vec![1.0; 99], &[0.5; 99], 1e-12, 200);
        // Symmetric: 50 different entries, as many steps.
        assert!(converged && iterations <= 51);
        for (k, x) in x.iter().enumerate() {
            let s = (k + 1) as f64;
            assert!((x - 0.5 * s * (100.0 - s)).abs() < 1e-8);
        }
    }

    #[test]
    fn nothing_to_do_takes_no_steps() {
        let (x, iterations, converged) = conjugate_gradients(chain, vec![0.0; 9], &[0.5; 9], 1e-12, 200);
        assert!(converged && iterations == 0 && x == vec![0.0; 9]);
    }

    #[test]
    fn what_is_not_positive_is_told() {
        let minus = |p: &[f64], q: &mut [f64]| q.iter_mut().zip(p).for_each(|(q, p)| *q = -p);
        assert!(!conjugate_gradients(minus, vec![1.0; 4], &[1.0; 4], 1e-12, 10).2);
    }
}
