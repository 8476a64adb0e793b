//! Nearest points on the zero set.

use rayon::prelude::*;

use crate::error::Result;
use crate::evaluate::CHUNK;
use crate::field::{Field, Spline};
use crate::mesh::TMesh;

const STEPS: usize = 40;
/// Distance, in units of the box, below which foot points and zero values count as reached.
const REACHED: f64 = 1e-12;

/// What foot points of a field are measured by.
#[derive(Clone, Copy)]
pub struct Limits<const D: usize> {
    /// Upper corner of the box; the lower one is the origin.
    pub high: [f64; D],
    /// The largest value: what counts as zero is measured against it.
    pub scale: f64,
    /// Longest step. A start further than that from the zero set may not arrive.
    pub max_travel: f64,
}

/// For every point the foot point on the zero set of a T-spline, started at `starts`, and whether it was reached: there
/// f = 0 and the way to the point is along the normal.
pub fn project<const D: usize>(
    mesh: &TMesh<D>,
    c: &[f64],
    points: &[[f64; D]],
    starts: &[[f64; D]],
    max_travel: f64,
) -> Result<(Vec<[f64; D]>, Vec<bool>)> {
    mesh.check_coefficients(c)?;
    let limits = Limits {
        high: [1.0; D],
        // Values are in the caller's units.
        scale: largest(c),
        max_travel,
    };
    Ok(project_on(|| Spline::new(mesh, c), &limits, points, starts))
}

/// The largest magnitude, positive.
pub fn largest(values: &[f64]) -> f64 {
    values
        .iter()
        .fold(0.0_f64, |m, v| m.max(v.abs()))
        .max(f64::MIN_POSITIVE)
}

/// As `project` on any field, made once a thread's chunk.
pub fn project_on<const D: usize, F: Field<D>>(
    field: impl Fn() -> F + Sync,
    limits: &Limits<D>,
    points: &[[f64; D]],
    starts: &[[f64; D]],
) -> (Vec<[f64; D]>, Vec<bool>) {
    let mut feet = starts.to_vec();
    let mut reached = vec![false; points.len()];
    feet.par_chunks_mut(CHUNK)
        .zip(reached.par_chunks_mut(CHUNK))
        .zip(points.par_chunks(CHUNK))
        .for_each(|((feet, reached), points)| {
            let mut field = field();
            for ((foot, ok), p) in feet.iter_mut().zip(reached).zip(points) {
                *ok = walk(&mut field, limits, p, foot);
            }
        });
    (feet, reached)
}

/// Move `x` to the foot point of `p`: the nearest point of the tangent plane of f at x, again and again; where that
/// does not settle (|kappa d| near 1), Newton steps straight to the zero set finish.
#[inline(always)]
pub fn walk<const D: usize>(
    field: &mut impl Field<D>,
    limits: &Limits<D>,
    p: &[f64; D],
    x: &mut [f64; D],
) -> bool {
    let (high, scale) = (limits.high, limits.scale);
    let flat = (1e-8 * scale).powi(2);
    let mut damping = 1.0;
    let mut last = f64::INFINITY;
    for _ in 0..STEPS {
        let f = field.jet(x);
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
        let share = (limits.max_travel / length.max(f64::MIN_POSITIVE)).min(1.0);
        for a in 0..D {
            x[a] = (x[a] + share * step[a]).clamp(0.0, high[a]);
        }
        if length < REACHED {
            return true;
        }
    }
    // The foot point was not settled; the zero set still may be reached.
    for _ in 0..4 {
        let f = field.jet(x);
        let square: f64 = f.gradient.iter().map(|g| g * g).sum();
        for a in 0..D {
            x[a] = (x[a] - f.gradient[a] * f.value / square.max(flat)).clamp(0.0, high[a]);
        }
    }
    let f = field.jet(x);
    let square: f64 = f.gradient.iter().map(|g| g * g).sum();
    let along: f64 = (0..D).map(|a| f.gradient[a] * (p[a] - x[a])).sum();
    let tangential: f64 = (0..D)
        .map(|a| (p[a] - x[a] - f.gradient[a] * along / square.max(flat)).powi(2))
        .sum();
    f.value.abs() < 1e-9 * scale && tangential.sqrt() < 1e-6
}
