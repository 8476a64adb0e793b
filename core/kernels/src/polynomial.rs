//! A T-spline on one element as a quotient of two tensor polynomials: cheaper than the basis functions, and the cheapest
//! by far once several points lie on the same element.

use multiversion::multiversion;

use crate::element::{Elements, Factor};
use crate::evaluate::{quotient, Jet};
use crate::local::{Cubics, Local};

/// Coefficients of a tensor cubic: entry `4 i + j` (`16 i + 4 j + k` in 3D) belongs to `s^i t^j (u^k)`. The first axis
/// is outermost, so that contracting it works on whole rows.
pub type Tensor = [f64; 64];

/// f = N / W on one element in its local coordinates. Made once a thread and loaded element by element.
pub struct Quotient<const D: usize> {
    numerator: Tensor,
    /// Not valid where the basis functions add up to 1.
    denominator: Tensor,
    unity: bool,
    corner: [f64; D],
    inverse: [f64; D],
    local: Local<D>,
}

impl<const D: usize> Default for Quotient<D> {
    fn default() -> Self {
        Self::new()
    }
}

impl<const D: usize> Quotient<D> {
    /// Room for an element; 0 everywhere until the first `load`.
    pub fn new() -> Self {
        Self {
            numerator: [0.0; 64],
            denominator: [0.0; 64],
            unity: true,
            corner: [0.0; D],
            inverse: [1.0; D],
            local: Local::new(),
        }
    }

    /// Take the polynomials of the field with coefficients `c` on an element.
    pub fn load(&mut self, elements: &Elements<D>, element: usize, c: &[f64]) {
        self.local.load(elements, element);
        let head = self.local.head();
        (self.corner, self.inverse, self.unity) = (head.corner, head.inverse, self.local.unity());
        let (factors, cubics) = (self.local.factors(), self.local.cubics());
        nested_sum(factors, cubics, Some(c), &mut self.numerator);
        if !self.unity {
            nested_sum(factors, cubics, None, &mut self.denominator);
        }
    }

    /// Take an element without its polynomials; those of the one before are lost.
    pub fn select(&mut self, elements: &Elements<D>, element: usize) -> &Local<D> {
        self.local.load(elements, element);
        &self.local
    }

    /// Coefficients of N.
    pub fn numerator(&self) -> &Tensor {
        &self.numerator
    }

    /// The field at a point of the element, derivatives up to `ORDER`.
    #[inline(always)]
    pub fn at<const ORDER: usize>(&self, x: &[f64; D]) -> Jet<D> {
        let t = std::array::from_fn(|a| (x[a] - self.corner[a]) * self.inverse[a]);
        let n = contract::<D, ORDER>(&self.numerator, &t, &self.inverse);
        if self.unity {
            n
        } else {
            quotient::<D, ORDER>(&n, &contract::<D, ORDER>(&self.denominator, &t, &self.inverse))
        }
    }
}

/// Sum of weight times product of cubics over factors that are sorted by piece, last axis first: what shares its pieces
/// along the later axes is summed along the first before it is multiplied out.
#[multiversion(targets("x86_64+avx+avx2"))]
pub(crate) fn nested_sum<const D: usize>(
    factors: &[Factor<D>],
    cubics: &Cubics<D>,
    weights: Option<&[f64]>,
    sum: &mut Tensor,
) {
    sum.fill(0.0);
    let mut k = 0;
    while k < factors.len() {
        let last = factors[k].piece[D - 1];
        let mut plane = [0.0; 16];
        while k < factors.len() && (D == 2 || factors[k].piece[D - 1] == last) {
            let second = factors[k].piece[1];
            let mut line = [0.0; 4];
            while k < factors.len()
                && factors[k].piece[1] == second
                && (D == 2 || factors[k].piece[D - 1] == last)
            {
                let w = weights.map_or(1.0, |c| c[factors[k].function as usize]);
                let p = &cubics[0][factors[k].piece[0] as usize];
                for i in 0..4 {
                    line[i] += w * p[i];
                }
                k += 1;
            }
            let q = &cubics[1][second as usize];
            for i in 0..4 {
                for j in 0..4 {
                    plane[4 * i + j] += line[i] * q[j];
                }
            }
        }
        if D == 2 {
            sum[..16].copy_from_slice(&plane);
        } else {
            let r = &cubics[D - 1][last as usize];
            for (row, v) in sum.chunks_exact_mut(4).zip(plane) {
                for k in 0..4 {
                    row[k] += v * r[k];
                }
            }
        }
    }
}

/// The K-th derivative at t of a cubic whose coefficients are the four rows of `a`, each `L` long.
#[inline(always)]
fn derivative<const L: usize, const K: usize>(a: &[f64], t: f64) -> [f64; L] {
    let (a0, a1, a2, a3) = (&a[..L], &a[L..2 * L], &a[2 * L..3 * L], &a[3 * L..4 * L]);
    std::array::from_fn(|l| match K {
        0 => a0[l] + t * (a1[l] + t * (a2[l] + t * a3[l])),
        1 => a1[l] + t * (2.0 * a2[l] + t * (3.0 * a3[l])),
        _ => 2.0 * a2[l] + t * (6.0 * a3[l]),
    })
}

/// Contract axis after axis; `s` turns derivatives in local coordinates into those in the unit box.
#[inline(always)]
fn contract<const D: usize, const ORDER: usize>(a: &Tensor, t: &[f64; D], s: &[f64; D]) -> Jet<D> {
    let mut jet = Jet::ZERO;
    if D == 2 {
        plane::<D, ORDER>(a, t, &mut jet);
    } else {
        space::<D, ORDER>(a, t, &mut jet);
    }
    for a in 0..D {
        if ORDER >= 1 {
            jet.gradient[a] *= s[a];
        }
        if ORDER >= 2 {
            for b in 0..D {
                jet.hessian[a][b] *= s[a] * s[b];
            }
        }
    }
    jet
}

#[inline(always)]
fn plane<const D: usize, const ORDER: usize>(a: &Tensor, t: &[f64; D], jet: &mut Jet<D>) {
    let v = derivative::<4, 0>(&a[..16], t[0]);
    [jet.value] = derivative::<1, 0>(&v, t[1]);
    if ORDER >= 1 {
        let x = derivative::<4, 1>(&a[..16], t[0]);
        [jet.gradient[0]] = derivative::<1, 0>(&x, t[1]);
        [jet.gradient[1]] = derivative::<1, 1>(&v, t[1]);
        if ORDER >= 2 {
            let xx = derivative::<4, 2>(&a[..16], t[0]);
            [jet.hessian[0][0]] = derivative::<1, 0>(&xx, t[1]);
            [jet.hessian[0][1]] = derivative::<1, 1>(&x, t[1]);
            [jet.hessian[1][1]] = derivative::<1, 2>(&v, t[1]);
            jet.hessian[1][0] = jet.hessian[0][1];
        }
    }
}

#[inline(always)]
fn space<const D: usize, const ORDER: usize>(a: &Tensor, t: &[f64; D], jet: &mut Jet<D>) {
    let (y, z) = (t[1], t[D - 1]);
    let v = derivative::<16, 0>(a, t[0]);
    let v_ = derivative::<4, 0>(&v, y);
    [jet.value] = derivative::<1, 0>(&v_, z);
    if ORDER >= 1 {
        let x = derivative::<16, 1>(a, t[0]);
        let (x_, v_y) = (derivative::<4, 0>(&x, y), derivative::<4, 1>(&v, y));
        [jet.gradient[0]] = derivative::<1, 0>(&x_, z);
        [jet.gradient[1]] = derivative::<1, 0>(&v_y, z);
        [jet.gradient[D - 1]] = derivative::<1, 1>(&v_, z);
        if ORDER >= 2 {
            let xx = derivative::<4, 0>(&derivative::<16, 2>(a, t[0]), y);
            let (xy, yy) = (derivative::<4, 1>(&x, y), derivative::<4, 2>(&v, y));
            let h = &mut jet.hessian;
            [h[0][0]] = derivative::<1, 0>(&xx, z);
            [h[0][1]] = derivative::<1, 0>(&xy, z);
            [h[1][1]] = derivative::<1, 0>(&yy, z);
            [h[0][D - 1]] = derivative::<1, 1>(&x_, z);
            [h[1][D - 1]] = derivative::<1, 1>(&v_y, z);
            [h[D - 1][D - 1]] = derivative::<1, 2>(&v_, z);
            for (i, j) in [(0, 1), (0, D - 1), (1, D - 1)] {
                h[j][i] = h[i][j];
            }
        }
    }
}
