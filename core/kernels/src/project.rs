//! Nearest points on the zero set.

use rayon::prelude::*;

use crate::error::Result;
use crate::evaluate::{field_at, Scratch, CHUNK};
use crate::mesh::TMesh;

const STEPS: usize = 40;
/// Distance, in units of the box, below which foot points and zero values count as reached.
const REACHED: f64 = 1e-12;

/// For every point the foot point on the zero set, started at `starts`, and whether it was reached: there f = 0 and
/// the way to the point is along the normal. Steps are at most `max_travel` long; a start further than that from the
/// zero set may not arrive.
pub fn project<const D: usize>(
    mesh: &TMesh<D>,
    c: &[f64],
    points: &[[f64; D]],
    starts: &[[f64; D]],
    max_travel: f64,
) -> Result<(Vec<[f64; D]>, Vec<bool>)> {
    mesh.check_coefficients(c)?;
    // Values are in the caller's units: what counts as zero is measured against the largest coefficient.
    let scale = c
        .iter()
        .fold(0.0_f64, |m, v| m.max(v.abs()))
        .max(f64::MIN_POSITIVE);
    let mut feet = starts.to_vec();
    let mut reached = vec![false; points.len()];
    feet.par_chunks_mut(CHUNK)
        .zip(reached.par_chunks_mut(CHUNK))
        .zip(points.par_chunks(CHUNK))
        .for_each(|((feet, reached), points)| {
            let mut scratch = Scratch::new();
            for ((foot, ok), p) in feet.iter_mut().zip(reached).zip(points) {
                *ok = walk(mesh, &mut scratch, c, scale, p, foot, max_travel);
            }
        });
    Ok((feet, reached))
}

/// Move `x` to the foot point of `p`: the nearest point of the tangent plane of f at x, again and again; where that
/// does not settle (|kappa d| near 1), Newton steps straight to the zero set finish.
fn walk<const D: usize>(
    mesh: &TMesh<D>,
    scratch: &mut Scratch<D>,
    c: &[f64],
    scale: f64,
    p: &[f64; D],
    x: &mut [f64; D],
    max_travel: f64,
) -> bool {
    let flat = (1e-8 * scale).powi(2);
    let mut damping = 1.0;
    let mut last = f64::INFINITY;
    for _ in 0..STEPS {
        let f = field_at::<D, 1>(mesh, scratch, c, x);
        let square: f64 = f.gradient.iter().map(|g| g * g).sum();
        if !f.value.is_finite() || square <= flat {
            return false;
        }
        let along: f64 = (0..D).map(|a| f.gradient[a] * (p[a] - x[a])).sum();
        // Normal part to the plane at once; the tangential part, which may overshoot on strong curvature, damped.
        let mut step = [0.0; D];
        for a in 0..D {
            let tangential = p[a] - x[a] - f.gradient[a] * along / square;
            step[a] = damping * tangential - f.gradient[a] * f.value / square;
        }
        let length = step.iter().map(|s| s * s).sum::<f64>().sqrt();
        if length > 0.7 * last {
            damping *= 0.5;
        }
        last = length;
        let share = (max_travel / length.max(f64::MIN_POSITIVE)).min(1.0);
        for a in 0..D {
            x[a] = (x[a] + share * step[a]).clamp(0.0, 1.0);
        }
        if length < REACHED {
            return true;
        }
    }
    // The foot point was not settled; the zero set still may be reached.
    for _ in 0..4 {
        let f = field_at::<D, 1>(mesh, scratch, c, x);
        let square: f64 = f.gradient.iter().map(|g| g * g).sum();
        for a in 0..D {
            x[a] = (x[a] - f.gradient[a] * f.value / square.max(flat)).clamp(0.0, 1.0);
        }
    }
    let f = field_at::<D, 1>(mesh, scratch, c, x);
    let square: f64 = f.gradient.iter().map(|g| g * g).sum();
    let along: f64 = (0..D).map(|a| f.gradient[a] * (p[a] - x[a])).sum();
    let tangential: f64 = (0..D)
        .map(|a| (p[a] - x[a] - f.gradient[a] * along / square.max(flat)).powi(2))
        .sum();
    f.value.abs() < 1e-9 * scale && tangential.sqrt() < 1e-6
}
