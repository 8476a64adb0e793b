//! Planes through patches of a point cloud.

use rayon::prelude::*;

use crate::error::{KernelError, Result};

/// The plane of a patch.
#[derive(Debug, Clone, Copy)]
pub struct Plane {
    pub center: [f64; 3],
    /// Unit normal, of either sign.
    pub normal: [f64; 3],
    /// Variances along the normal and the two directions in the plane, ascending.
    pub variance: [f64; 3],
}

/// The least-squares plane of the points `patches[q]` around each query point, weighted by (1 - (r/R)^2)^2 with R the
/// distance of the patch's farthest point.
pub fn planes(points: &[[f64; 3]], queries: &[[f64; 3]], patches: &[&[i64]]) -> Result<Vec<Plane>> {
    if patches
        .iter()
        .any(|patch| patch.iter().any(|&p| p < 0 || p as usize >= points.len()))
    {
        return Err(KernelError::Invalid(
            "patches: a number that is no point's".into(),
        ));
    }
    Ok(queries
        .par_iter()
        .zip(patches)
        .with_min_len(64)
        .map(|(query, patch)| plane(points, query, patch))
        .collect())
}

fn plane(points: &[[f64; 3]], query: &[f64; 3], patch: &[i64]) -> Plane {
    let square = |p: &[f64; 3]| (0..3).map(|a| (p[a] - query[a]).powi(2)).sum::<f64>();
    let reach = patch
        .iter()
        .map(|&p| square(&points[p as usize]))
        .fold(0.0, f64::max);
    let (mut total, mut first, mut second) = (0.0, [0.0; 3], [[0.0; 3]; 3]);
    for &p in patch {
        let p = &points[p as usize];
        let near = if reach > 0.0 { 1.0 - square(p) / reach } else { 1.0 };
        // The farthest point keeps a trace of weight: a patch of few points must not lose its plane.
        let w = near * near + 1e-3;
        let d: [f64; 3] = std::array::from_fn(|a| p[a] - query[a]);
        total += w;
        for a in 0..3 {
            first[a] += w * d[a];
            for b in 0..=a {
                second[a][b] += w * d[a] * d[b];
            }
        }
    }
    let mean = first.map(|v| v / total);
    let mut c = [[0.0; 3]; 3];
    for a in 0..3 {
        for b in 0..=a {
            c[a][b] = second[a][b] / total - mean[a] * mean[b];
            c[b][a] = c[a][b];
        }
    }
    let (variance, axes) = eigen(c);
    Plane {
        center: std::array::from_fn(|a| query[a] + mean[a]),
        normal: axes[0],
        variance,
    }
}

/// Eigenvalues of a symmetric matrix, ascending, and their unit eigenvectors: cyclic Jacobi rotations.
pub fn eigen(mut c: [[f64; 3]; 3]) -> ([f64; 3], [[f64; 3]; 3]) {
    let mut v = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
    for _ in 0..12 {
        let off = c[0][1].abs() + c[0][2].abs() + c[1][2].abs();
        let on = c[0][0].abs() + c[1][1].abs() + c[2][2].abs();
        if off <= 1e-16 * on {
            break;
        }
        for (p, q) in [(0, 1), (0, 2), (1, 2)] {
            if c[p][q] == 0.0 {
                continue;
            }
            let theta = (c[q][q] - c[p][p]) / (2.0 * c[p][q]);
            let t = theta.signum() / (theta.abs() + theta.hypot(1.0));
            let cos = 1.0 / t.hypot(1.0);
            let sin = t * cos;
            for row in &mut c {
                let (a, b) = (row[p], row[q]);
                row[p] = cos * a - sin * b;
                row[q] = sin * a + cos * b;
            }
            for k in 0..3 {
                let (a, b) = (c[p][k], c[q][k]);
                c[p][k] = cos * a - sin * b;
                c[q][k] = sin * a + cos * b;
            }
            for row in &mut v {
                let (a, b) = (row[p], row[q]);
                row[p] = cos * a - sin * b;
                row[q] = sin * a + cos * b;
            }
        }
    }
    let mut order = [0, 1, 2];
    order.sort_by(|&a, &b| c[a][a].total_cmp(&c[b][b]));
    (order.map(|a| c[a][a]), order.map(|a| [v[0][a], v[1][a], v[2][a]]))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn eigenvectors_rebuild_the_matrix() {
        let c = [[2.0, -1.0, 0.5], [-1.0, 3.0, 0.25], [0.5, 0.25, 1.0]];
        let (w, v) = eigen(c);
        assert!(w[0] <= w[1] && w[1] <= w[2]);
        for a in 0..3 {
            for b in 0..3 {
                let sum: f64 = (0..3).map(|k| w[k] * v[k][a] * v[k][b]).sum();
                assert!((sum - c[a][b]).abs() < 1e-14);
            }
        }
    }

    #[test]
    fn points_of_a_plane_give_its_normal() {
        let points: Vec<[f64; 3]> = (0..25)
            .map(|q| {
                let (s, t) = (f64::from(q % 5), f64::from(q / 5));
                [s, t, 1.0 + 2.0 * s - t]
            })
            .collect();
        let patch: Vec<i64> = (0..25).collect();
        let plane = planes(&points, &[points[12]], &[&patch]).unwrap()[0];
        let n = plane.normal;
        let along = (n[0] * -2.0 + n[1] + n[2]).abs() / 6f64.sqrt();
        assert!((along - 1.0).abs() < 1e-12 && plane.variance[0].abs() < 1e-12);
    }
}
