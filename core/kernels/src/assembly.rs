//! The normal equations of one element.

use crate::dense::RowBlock;
use crate::evaluate::{basis_on, quotient, Jet, Scratch};
use crate::gauss::{gauss_points, Gauss, Slopes};
use crate::mesh::TMesh;
use crate::system::{norm, Equations, FLAT};

/// Fairness fades with the distance from the zero set; below this part of its weight it is left out.
const FADED: f64 = 1e-9;

/// Assembles elements one after another; each thread has its own.
pub struct Worker<'a, const D: usize> {
    mesh: &'a TMesh<D>,
    eq: &'a Equations<'a, D>,
    scratch: Scratch<D>,
    gauss: Gauss<D>,
    basis: Vec<Jet<D>>,
    slopes: Vec<Slopes>,
    block: RowBlock,
}

impl<'a, const D: usize> Worker<'a, D> {
    pub fn new(mesh: &'a TMesh<D>, eq: &'a Equations<'a, D>) -> Self {
        let most = mesh.elements().max_factors();
        Self {
            mesh,
            eq,
            scratch: Scratch::new(),
            gauss: Gauss::new(),
            basis: Vec::with_capacity(most),
            slopes: Vec::with_capacity(most),
            block: RowBlock::new(),
        }
    }

    /// Add element `e` with its samples to the rows at `slots` of `partial`. Returns the weighted squares of
    /// |grad f| - 1 and the weights, summed over the element.
    pub fn element(&mut self, e: usize, samples: &[u32], slots: &[u32], partial: &mut [f64]) -> [f64; 2] {
        let size = self.scratch.select(self.mesh.elements(), e).factors().len();
        self.block.start(size);
        let sums = self.constraint(e);
        for &k in samples {
            self.sample(e, k as usize);
        }
        self.block.flush();
        let mut rest = slots;
        for (a, row) in self
            .block
            .matrix
            .chunks_exact(self.block.stride())
            .take(size)
            .enumerate()
        {
            let (mine, other) = rest.split_at(a + 1);
            for (&at, value) in mine.iter().zip(row) {
                partial[at as usize] += value;
            }
            // The right-hand side stands behind the diagonal.
            partial[mine[a] as usize + 1] += self.block.rhs[a];
            rest = other;
        }
        sums
    }

    fn load<const ORDER: usize>(&mut self, e: usize, x: &[f64; D]) -> Jet<D> {
        basis_on::<D, ORDER>(self.mesh.elements(), e, &mut self.scratch, x, &mut self.basis);
        let mut f = Jet::ZERO;
        for (b, factor) in self.basis.iter().zip(self.scratch.factors()) {
            let c = self.eq.coefficients[factor.function as usize];
            f.value += c * b.value;
            for a in 0..D {
                f.gradient[a] += c * b.gradient[a];
            }
            if ORDER >= 2 {
                for a in 0..D {
                    for k in 0..D {
                        f.hessian[a][k] += c * b.hessian[a][k];
                    }
                }
            }
        }
        f
    }

    /// Numerator and denominator of f at the Gauss points; the basis functions go into `slopes`.
    fn load_gauss(&mut self, e: usize) -> [Slopes; 2] {
        let elements = self.mesh.elements();
        self.gauss.load(elements, e);
        self.slopes.clear();
        let mut n: Slopes = [[0.0; 8]; 4];
        let mut w: Slopes = [[0.0; 8]; 4];
        for factor in self.gauss.factors() {
            let c = self.eq.coefficients[factor.function as usize];
            let b = self.gauss.product(factor);
            for k in 0..=D {
                for l in 0..1 << D {
                    n[k][l] += c * b[k][l];
                    w[k][l] += b[k][l];
                }
            }
            self.slopes.push(b);
        }
        [n, w]
    }

    /// The distance-field constraint at the `2^D` Gauss points, with the corrected (3.13), and the fairness term.
    fn constraint(&mut self, e: usize) -> [f64; 2] {
        let mut sums = [0.0; 2];
        if self.eq.constraint_weight == 0.0 && self.eq.fairness == 0.0 {
            return sums;
        }
        let (_, side) = self.mesh.elements().frame(e);
        let volume: f64 = side.iter().product::<f64>() / f64::from(1_u32 << D);
        let width = side.iter().copied().fold(0.0, f64::max);
        let [numerator, denominator] = self.load_gauss(e);
        // The row of point l is sum_k mix[k][l] * slopes[..][k][l] = n . grad b.
        let mut mix: Slopes = [[0.0; 8]; 4];
        let (mut weight, mut wanted, mut fair) = ([0.0; 8], [0.0; 8], [0.0; 8]);
        for l in 0..1 << D {
            let take = |s: &Slopes| Jet {
                value: s[0][l],
                gradient: std::array::from_fn(|a| s[1 + a][l]),
                hessian: [[0.0; D]; D],
            };
            let w = take(&denominator);
            let f = quotient::<D, 1>(&take(&numerator), &w);
            let slope = norm(&f.gradient);
            let distance = f.value / width;
            fair[l] = (-(0.5 * distance).powi(2)).exp();
            if slope <= FLAT {
                continue;
            }
            let near = (-(distance / self.eq.constraint_band).powi(2)).exp();
            let share = volume * (self.eq.far_weight + (1.0 - self.eq.far_weight) * near);
            weight[l] = self.eq.constraint_weight * share;
            wanted[l] = -(slope - 1.0) * self.eq.relaxation;
            let inverse = 1.0 / w.value;
            for a in 0..D {
                mix[1 + a][l] = f.gradient[a] / slope * inverse;
                mix[0][l] -= mix[1 + a][l] * w.gradient[a] * inverse;
            }
            sums[0] += share * (slope - 1.0) * (slope - 1.0);
            sums[1] += share;
        }
        if weight.iter().any(|&w| w > 0.0) {
            self.constraint_rows(&mix, &wanted, &weight);
        }
        if self.eq.fairness > 0.0 {
            for (l, &part) in fair.iter().enumerate().take(1 << D).filter(|f| *f.1 > FADED) {
                self.fairness(e, l, self.eq.fairness * volume * part);
            }
        }
        sums
    }

    fn constraint_rows(&mut self, mix: &Slopes, wanted: &[f64; 8], weight: &[f64; 8]) {
        let stride = self.block.stride();
        for half in 0..(1 << D) / 4 {
            let pick = |v: &[f64; 8]| -> [f64; 4] { std::array::from_fn(|l| v[4 * half + l]) };
            let rows = self.block.four_rows(pick(wanted), pick(weight));
            let mix: [[f64; 4]; 4] = std::array::from_fn(|k| pick(&mix[k]));
            for (i, b) in self.slopes.iter().enumerate() {
                let mut entry = [0.0; 4];
                for k in 0..=D {
                    for l in 0..4 {
                        entry[l] += mix[k][l] * b[k][4 * half + l];
                    }
                }
                for l in 0..4 {
                    rows[l * stride + i] = entry[l];
                }
            }
        }
    }

    /// Squared Frobenius norm of D^2 (f + dt cdot) at the l-th Gauss point.
    fn fairness(&mut self, e: usize, l: usize, weight: f64) {
        let (corner, side) = self.mesh.elements().frame(e);
        let x = std::array::from_fn(|a| corner[a] + side[a] * gauss_points()[(l >> a) & 1]);
        let f = self.load::<2>(e, &x);
        let step = self.eq.time_step;
        for a in 0..D {
            for c in a..D {
                let factor = if a == c { 1.0 } else { 2.0 };
                let row = self.block.row(-f.hessian[a][c], weight * factor);
                for (r, b) in row.iter_mut().zip(&self.basis) {
                    *r = step * b.hessian[a][c];
                }
            }
        }
    }

    /// The evolution term at one sample of the zero set, divided by |grad f|, curvature semi-implicit.
    fn sample(&mut self, e: usize, k: usize) {
        let x = &self.eq.points[k];
        let smoothing = self.eq.smoothing.map_or(0.0, |s| s[k]);
        let f = if smoothing > 0.0 {
            self.load::<2>(e, x)
        } else {
            self.load::<1>(e, x)
        };
        let slope = if self.eq.plain { 1.0 } else { norm(&f.gradient) };
        if slope <= FLAT {
            return;
        }
        let (speed, weight) = (self.eq.speed[k], self.eq.weights[k]);
        if smoothing > 0.0 {
            let n = f.gradient.map(|g| g / slope);
            let factor = self.eq.time_step * smoothing;
            let row = self.block.row(
                smoothing * tangential_trace(&n, &f.hessian) / slope - speed,
                weight,
            );
            for (r, b) in row.iter_mut().zip(&self.basis) {
                *r = (b.value - factor * tangential_trace(&n, &b.hessian)) / slope;
            }
        } else {
            let row = self.block.row(-speed, weight);
            for (r, b) in row.iter_mut().zip(&self.basis) {
                *r = b.value / slope;
            }
        }
    }
}

/// (I - n n^T) : H
fn tangential_trace<const D: usize>(n: &[f64; D], h: &[[f64; D]; D]) -> f64 {
    let mut trace = 0.0;
    for a in 0..D {
        trace += h[a][a];
        for c in 0..D {
            trace -= n[a] * n[c] * h[a][c];
        }
    }
    trace
}
