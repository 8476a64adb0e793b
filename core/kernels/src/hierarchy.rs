//! A hierarchy of cubic B-splines fitted to points, coarse to fine.
//!
//! f = sum over levels of c B: each level corrects the one above it near its own cells only and starts from its exact
//! prolongation, so that f is C2 everywhere and the far field stays what the coarse levels made it. A level minimises
//!
//!   sum a (f(x) - t)^2 + sum b (|n . grad f - 1|^2 + s |P grad f|^2) + r^3 int (Laplace f)^2,
//!
//! by conjugate gradients. For a correction that vanishes at the band's rim the last integral equals that of the
//! Hessian's square; on the lattice it is the seven-point Laplacian of the coefficients applied twice.

use rayon::prelude::*;

use crate::conjugate::conjugate_gradients;
use crate::error::{KernelError, Result};
use crate::lattice::Lattice;
use crate::rows::{bends, slopes, values, Rows, Target};

/// Nodes of a chunk: sums over chunks are added in order.
const CHUNK: usize = 4096;
const NONE: u32 = u32::MAX;

/// Weights of one fit.
#[derive(Debug, Clone, Copy)]
pub struct Weights {
    /// Smoothing length r, in units of the box.
    pub smoothing: f64,
    /// Curvature k above which bending costs less, in units of 1 / box: the square of a Laplacian u counts
    /// 1 / (1 + (u / k)^2) times, so that creases and the field's own ridges stay. 0: no limit.
    pub kink: f64,
    /// Share s of the tangential part of the gradient.
    pub tangential: f64,
    /// Reduction of the residual at which the iteration ends.
    pub tolerance: f64,
    pub max_iterations: usize,
}

/// What a fit did.
#[derive(Debug, Clone, Copy)]
pub struct Outcome {
    pub iterations: usize,
    pub converged: bool,
    pub unknowns: usize,
}

/// The levels, coarsest first.
#[derive(Debug, Clone, Default)]
pub struct Hierarchy {
    levels: Vec<Lattice>,
}

impl Hierarchy {
    /// All cells of one level, coefficients 0.
    pub fn new(level: u8) -> Result<Self> {
        if level > 6 {
            return Err(KernelError::TooLarge(format!(
                "level: found {level}, accepted is 0 to 6"
            )));
        }
        let n = 1u32 << level;
        let cells: Vec<[u32; 3]> = (0..n * n * n).map(|q| [q / (n * n), q / n % n, q % n]).collect();
        Ok(Self {
            levels: vec![Lattice::new(level, &cells)?],
        })
    }

    /// The next level, near `cells`; their parents must have been cells of the level before.
    pub fn refine(&mut self, cells: &[[u32; 3]]) -> Result<()> {
        let coarse = self.finest()?;
        let mut fine = Lattice::new(coarse.level() + 1, cells)?;
        fine.prolong(coarse)?;
        self.levels.push(fine);
        Ok(())
    }

    /// Drop the finest level.
    pub fn retreat(&mut self) -> Result<()> {
        if self.levels.len() < 2 {
            return Err(KernelError::Invalid(
                "the coarsest level cannot be dropped".into(),
            ));
        }
        self.levels.pop();
        Ok(())
    }

    /// The finest level.
    pub fn finest(&self) -> Result<&Lattice> {
        self.levels
            .last()
            .ok_or_else(|| KernelError::Invalid("a hierarchy without levels".into()))
    }

    /// Fit the finest level to `targets` at `points`, starting from its coefficients; points that its cells do not hold
    /// are refused.
    pub fn fit(&mut self, points: &[[f64; 3]], targets: &[Target], weights: &Weights) -> Result<Outcome> {
        let lattice = self
            .levels
            .last_mut()
            .ok_or_else(|| KernelError::Invalid("a hierarchy without levels".into()))?;
        check(points, targets, weights)?;
        let rows = Rows::new(lattice, points, targets, weights.tangential)?;
        let n = f64::from(1u32 << lattice.level());
        // Integral of the squared Laplacian: nodes stand for h^3, differences are over h^2.
        let bending = Bending::new(lattice, weights.smoothing.powi(3) * n, weights.kink);
        let size = lattice.len();
        let mut diagonal = vec![0.0; size];
        rows.diagonal(&mut diagonal);
        bending.diagonal(&mut diagonal);
        let active = &lattice.active;
        let inverse: Vec<f64> = diagonal
            .iter()
            .zip(active)
            .map(|(&d, &a)| if a && d > 0.0 { 1.0 / d } else { 0.0 })
            .collect();
        let unknowns = inverse.iter().filter(|&&v| v > 0.0).count();
        let mut r = vec![0.0; size];
        rows.residual(&lattice.coefficients, &mut r);
        bending.multiply(&lattice.coefficients, &mut r, -1.0);
        mask(&mut r, &inverse);
        let (x, iterations, converged) = conjugate_gradients(
            |p, q| {
                q.fill(0.0);
                rows.multiply(p, q);
                bending.multiply(p, q, 1.0);
                mask(q, &inverse);
            },
            r,
            &inverse,
            weights.tolerance,
            weights.max_iterations,
        );
        for (c, d) in lattice.coefficients.iter_mut().zip(&x) {
            *c += d;
        }
        Ok(Outcome {
            iterations,
            converged,
            unknowns,
        })
    }

    /// Value, gradient and level at each point, on the finest level that holds the point's cell; +inf outside of the box.
    pub fn evaluate(&self, points: &[[f64; 3]]) -> Vec<([f64; 4], u8)> {
        points
            .par_iter()
            .with_min_len(256)
            .map(|x| {
                if x.iter().any(|v| !(0.0..=1.0).contains(v)) {
                    return ([f64::INFINITY, f64::NAN, f64::NAN, f64::NAN], 0);
                }
                for lattice in self.levels.iter().rev() {
                    let (cell, t) = lattice.locate(x);
                    let Some(base) = lattice.cell(cell) else { continue };
                    let n = f64::from(1u32 << lattice.level());
                    let v = t.map(values);
                    let g = t.map(|t| slopes(t).map(|v| n * v));
                    let c = &lattice.coefficients;
                    let jet = [
                        contract(c, &base, [&v[0], &v[1], &v[2]]),
                        contract(c, &base, [&g[0], &v[1], &v[2]]),
                        contract(c, &base, [&v[0], &g[1], &v[2]]),
                        contract(c, &base, [&v[0], &v[1], &g[2]]),
                    ];
                    return (jet, lattice.level());
                }
                ([f64::INFINITY, f64::NAN, f64::NAN, f64::NAN], 0)
            })
            .collect()
    }

    /// Laplacians at points of the box, on the finest lattice that holds each; NaN where none does.
    pub fn laplacians(&self, points: &[[f64; 3]]) -> Vec<f64> {
        let at = |x: &[f64; 3]| {
            if x.iter().any(|v| !(0.0..=1.0).contains(v)) {
                return f64::NAN;
            }
            for lattice in self.levels.iter().rev() {
                let (cell, t) = lattice.locate(x);
                let Some(base) = lattice.cell(cell) else { continue };
                let n = f64::from(1u32 << lattice.level());
                let (v, h) = (t.map(values), t.map(bends));
                let c = &lattice.coefficients;
                let sum = contract(c, &base, [&h[0], &v[1], &v[2]])
                    + contract(c, &base, [&v[0], &h[1], &v[2]])
                    + contract(c, &base, [&v[0], &v[1], &h[2]]);
                return n * n * sum;
            }
            f64::NAN
        };
        points.par_iter().with_min_len(256).map(at).collect()
    }

    /// Coefficients of a T-spline by its dual functionals (de Boor and Fix): for local knots k0..k4 an axis the blossom
    /// of f at (k1, k2, k3), from value, slope and bend at k2. Exact where the T-mesh is a uniform lattice that holds f.
    pub fn coefficients(&self, knots: &[[[f64; 5]; 3]]) -> Result<Vec<f64>> {
        knots
            .par_iter()
            .with_min_len(256)
            .map(|k| {
                let x = [k[0][2], k[1][2], k[2][2]];
                for lattice in self.levels.iter().rev() {
                    let (cell, t) = lattice.locate(&x);
                    let Some(base) = lattice.cell(cell) else { continue };
                    let n = f64::from(1u32 << lattice.level());
                    let dual: [[f64; 4]; 3] = std::array::from_fn(|a| {
                        let (before, after) = (n * (k[a][1] - k[a][2]), n * (k[a][3] - k[a][2]));
                        let (v, g, h) = (values(t[a]), slopes(t[a]), bends(t[a]));
                        std::array::from_fn(|q| {
                            v[q] + g[q] * (before + after) / 3.0 + h[q] * before * after / 6.0
                        })
                    });
                    let c = &lattice.coefficients;
                    return Ok(contract(c, &base, [&dual[0], &dual[1], &dual[2]]));
                }
                Err(KernelError::Invalid(
                    "knots: an anchor outside of the unit box".into(),
                ))
            })
            .collect()
    }

    /// Levels, coarsest first.
    pub fn levels(&self) -> &[Lattice] {
        &self.levels
    }
}

/// Refuse what would leave unknowns without equations, in words.
fn check(points: &[[f64; 3]], targets: &[Target], weights: &Weights) -> Result<()> {
    let settings = [
        ("smoothing", weights.smoothing),
        ("tangential", weights.tangential),
        ("tolerance", weights.tolerance),
        ("kink", weights.kink),
    ];
    if let Some((name, v)) = settings.iter().find(|(_, v)| !(v.is_finite() && *v >= 0.0)) {
        return Err(KernelError::Invalid(format!(
            "{name}: found {v}, accepted are finite numbers >= 0"
        )));
    }
    if let Some(k) = points
        .iter()
        .position(|x| !x.iter().all(|v| (0.0..=1.0).contains(v)))
    {
        return Err(KernelError::Invalid(format!(
            "points: point {k} at {:?} lies outside the unit box",
            points[k]
        )));
    }
    let weighs = |w: f64| w.is_finite() && w >= 0.0;
    let unsound = |t: &Target| {
        if !weighs(t.weight) {
            Some("weights")
        } else if !t.value.is_finite() {
            Some("targets")
        } else if !weighs(t.normal_weight) {
            Some("normal_weights")
        } else if !t.normal.iter().all(|v| v.is_finite()) {
            Some("normals")
        } else if !t.slope.is_finite() {
            Some("slope")
        } else {
            None
        }
    };
    match targets
        .iter()
        .enumerate()
        .find_map(|(k, t)| Some((k, unsound(t)?)))
    {
        Some((k, name)) => Err(KernelError::Invalid(format!(
            "{name}: row {k} is {:?}, accepted are finite numbers and weights >= 0",
            targets[k]
        ))),
        None => Ok(()),
    }
}

/// sum c a_i b_j d_k over the nodes of a cell.
#[inline]
fn contract(c: &[f64], base: &[u32; 16], [a, b, d]: [&[f64; 4]; 3]) -> f64 {
    let mut sum = 0.0;
    for i in 0..4 {
        let mut part = 0.0;
        for j in 0..4 {
            let at = base[4 * i + j] as usize;
            let line = &c[at..at + 4];
            part += b[j] * ((line[0] * d[0] + line[1] * d[1]) + (line[2] * d[2] + line[3] * d[3]));
        }
        sum += a[i] * part;
    }
    sum
}

/// Zero where there is nothing to solve for.
fn mask(values: &mut [f64], inverse: &[f64]) {
    values
        .par_iter_mut()
        .zip(inverse)
        .with_min_len(CHUNK)
        .for_each(|(v, &i)| {
            if i == 0.0 {
                *v = 0.0;
            }
        });
}

/// The bending energy of the coefficients: `weight` times the sum of squared seven-point Laplacians, over the nodes that
/// have all six neighbours.
struct Bending {
    neighbours: Vec<[u32; 6]>,
    weight: f64,
    /// Share of every node's square.
    share: Vec<f64>,
}

impl Bending {
    fn new(lattice: &Lattice, weight: f64, kink: f64) -> Self {
        let mut bending = Self {
            neighbours: lattice.neighbours(),
            weight,
            share: vec![1.0; lattice.len()],
        };
        if kink > 0.0 {
            let n = f64::from(1u32 << lattice.level());
            let scale = n * n / kink;
            bending.share = bending
                .laplacian(&lattice.coefficients)
                .into_par_iter()
                .map(|u| 1.0 / (1.0 + (scale * u).powi(2)))
                .collect();
        }
        bending
    }

    /// Sevenpoint Laplacian, times the node's share of its square.
    fn laplacian(&self, x: &[f64]) -> Vec<f64> {
        self.neighbours
            .par_iter()
            .zip(x.par_iter().zip(&self.share))
            .with_min_len(CHUNK)
            .map(|(n, (&own, share))| {
                if whole(n) {
                    share * (sum_whole(n, x) - 6.0 * own)
                } else {
                    0.0
                }
            })
            .collect()
    }

    /// y += sign * weight * L^T L x.
    fn multiply(&self, x: &[f64], y: &mut [f64], sign: f64) {
        let factor = sign * self.weight;
        let u = self.laplacian(x);
        y.par_iter_mut()
            .zip(&self.neighbours)
            .zip(&u)
            .with_min_len(CHUNK)
            .for_each(|((y, n), &own)| {
                // A node at the rim has no Laplacian of its own, but lies in those of its neighbours.
                let around = if whole(n) {
                    sum_whole(n, &u)
                } else {
                    sum_stored(n, &u)
                };
                *y += factor * (around - 6.0 * own);
            });
    }

    fn diagonal(&self, y: &mut [f64]) {
        for (y, (n, share)) in y.iter_mut().zip(self.neighbours.iter().zip(&self.share)) {
            let beside = n
                .iter()
                .filter(|&&q| q != NONE && whole(&self.neighbours[q as usize]));
            let around: f64 = beside.map(|&q| self.share[q as usize]).sum();
            let own = if whole(n) { 36.0 * share } else { 0.0 };
            *y += (own + around) * self.weight;
        }
    }
}

fn whole(n: &[u32; 6]) -> bool {
    n.iter().all(|&q| q != NONE)
}

#[inline]
fn sum_whole(n: &[u32; 6], x: &[f64]) -> f64 {
    let at = |a: usize| x[n[a] as usize];
    (at(0) + at(1)) + (at(2) + at(3)) + (at(4) + at(5))
}

fn sum_stored(n: &[u32; 6], x: &[f64]) -> f64 {
    n.iter().filter(|&&q| q != NONE).map(|&q| x[q as usize]).sum()
}

#[cfg(test)]
mod tests {
    use super::*;

    const WEIGHTS: Weights = Weights {
        smoothing: 0.1,
        kink: 0.0,
        tangential: 1.0,
        tolerance: 1e-13,
        max_iterations: 5000,
    };

    /// Values and gradients of 1 + x - 2 y + 3 z at 12^3 points.
    fn linear() -> (Vec<[f64; 3]>, Vec<Target>) {
        let points: Vec<[f64; 3]> = (0..1728)
            .map(|q| [q / 144, q / 12 % 12, q % 12].map(|v| (f64::from(v) + 0.5) / 12.0))
            .collect();
        let targets = points
            .iter()
            .map(|x| Target {
                weight: 1.0,
                value: 1.0 + x[0] - 2.0 * x[1] + 3.0 * x[2],
                normal_weight: 0.0,
                normal: [0.0; 3],
                slope: 1.0,
            })
            .collect();
        (points, targets)
    }

    #[test]
    fn a_linear_function_is_fitted_and_refined_exactly() {
        let (points, targets) = linear();
        let mut field = Hierarchy::new(2).unwrap();
        assert!(field.fit(&points, &targets, &WEIGHTS).unwrap().converged);
        for _ in 0..2 {
            for ((jet, _), target) in field.evaluate(&points).iter().zip(&targets) {
                assert!((jet[0] - target.value).abs() < 1e-9);
                assert!((jet[1] - 1.0).abs() + (jet[2] + 2.0).abs() + (jet[3] - 3.0).abs() < 1e-7);
            }
            field.refine(&[[1, 2, 3], [2, 2, 3]]).unwrap();
        }
        assert!(field.refine(&[[30, 30, 30]]).is_err());
        assert_eq!(field.levels().len(), 3);
    }

    #[test]
    fn the_bending_s_diagonal_is_that_of_its_matrix() {
        let mut lattice = Lattice::new(3, &[[0, 0, 0], [5, 5, 5]]).unwrap();
        for (q, c) in lattice.coefficients.iter_mut().enumerate() {
            *c = (q as f64).sin();
        }
        let bending = Bending::new(&lattice, 0.7, 20.0);
        let size = lattice.len();
        let mut diagonal = vec![0.0; size];
        bending.diagonal(&mut diagonal);
        for q in (0..size).step_by(5) {
            let (mut unit, mut y) = (vec![0.0; size], vec![0.0; size]);
            unit[q] = 1.0;
            bending.multiply(&unit, &mut y, 1.0);
            assert!((y[q] - diagonal[q]).abs() < 1e-12);
        }
    }
}
