//! Values, gradients and Hessians of a rational T-spline, and of its basis functions, at single points.

use rayon::prelude::*;

use crate::bspline::jet;
use crate::element::{Elements, Factor};
use crate::local::Local;
use crate::mesh::TMesh;

/// Points in one unit of parallel work.
pub const CHUNK: usize = 1024;

/// Value, gradient and Hessian of a field at a point of the unit box.
#[derive(Debug, Clone, Copy)]
pub struct Jet<const D: usize> {
    pub value: f64,
    pub gradient: [f64; D],
    pub hessian: [[f64; D]; D],
}

impl<const D: usize> Jet<D> {
    /// What a field is outside its box: +infinity, with derivatives that are not numbers.
    pub const OUTSIDE: Self = Self {
        value: f64::INFINITY,
        gradient: [f64::NAN; D],
        hessian: [[f64::NAN; D]; D],
    };
    pub const ZERO: Self = Self {
        value: 0.0,
        gradient: [0.0; D],
        hessian: [[0.0; D]; D],
    };
}

/// Scratch of one thread: an element, and jets of its univariate pieces at one point, in units of the box. 256 places an
/// axis make every `u8` a valid index.
pub struct Scratch<const D: usize> {
    local: Local<D>,
    pieces: Box<[[[f64; 3]; 256]; D]>,
}

impl<const D: usize> Default for Scratch<D> {
    fn default() -> Self {
        Self::new()
    }
}

impl<const D: usize> Scratch<D> {
    pub fn new() -> Self {
        Self {
            local: Local::new(),
            pieces: Box::new([[[0.0; 3]; 256]; D]),
        }
    }

    /// Take an element.
    #[inline]
    pub fn select(&mut self, elements: &Elements<D>, element: usize) -> &Local<D> {
        self.local.load(elements, element);
        &self.local
    }

    /// Basis functions on the element that was taken last.
    #[inline]
    pub fn factors(&self) -> &[Factor<D>] {
        self.local.factors()
    }

    /// Evaluate the element's pieces at `x`.
    #[inline]
    pub fn load(&mut self, elements: &Elements<D>, element: usize, x: &[f64; D]) {
        self.local.load(elements, element);
        let head = *self.local.head();
        for a in 0..D {
            let scale = head.inverse[a];
            let t = (x[a] - head.corner[a]) * scale;
            for (slot, cubic) in self.pieces[a].iter_mut().zip(self.local.pieces(a)) {
                let [v, d, s] = jet(cubic, t);
                *slot = [v, d * scale, s * scale * scale];
            }
        }
    }

    /// Unnormalised B_i with derivatives up to `ORDER`.
    #[inline]
    pub fn product<const ORDER: usize>(&self, piece: [u8; D]) -> Jet<D> {
        let u: [[f64; 3]; D] = std::array::from_fn(|a| self.pieces[a][piece[a] as usize]);
        let mut b = Jet::ZERO;
        b.value = (0..D).map(|a| u[a][0]).product();
        if ORDER >= 1 {
            for a in 0..D {
                b.gradient[a] = (0..D).map(|k| u[k][usize::from(k == a)]).product();
            }
        }
        if ORDER >= 2 {
            for a in 0..D {
                for c in a..D {
                    let h: f64 = (0..D)
                        .map(|k| u[k][usize::from(k == a) + usize::from(k == c)])
                        .product();
                    b.hessian[a][c] = h;
                    b.hessian[c][a] = h;
                }
            }
        }
        b
    }

    /// Sum of weight times B_i over an element's factors. They are sorted by piece, last axis first: what shares its
    /// pieces along the later axes is summed along the first before it is multiplied out.
    #[inline]
    fn sum<const ORDER: usize>(&self, factors: &[Factor<D>], weight: impl Fn(u32) -> f64) -> Jet<D> {
        let mut total = [[[0.0; 3]; 3]; 3];
        let mut k = 0;
        while k < factors.len() {
            let last = factors[k].piece[D - 1];
            let mut plane = [[0.0; 3]; 3];
            while k < factors.len() && (D == 2 || factors[k].piece[D - 1] == last) {
                let second = factors[k].piece[1];
                let mut line = [0.0; 3];
                while k < factors.len()
                    && factors[k].piece[1] == second
                    && (D == 2 || factors[k].piece[D - 1] == last)
                {
                    let w = weight(factors[k].function);
                    let u = &self.pieces[0][factors[k].piece[0] as usize];
                    for i in 0..=ORDER {
                        line[i] += w * u[i];
                    }
                    k += 1;
                }
                let v = &self.pieces[1][second as usize];
                for i in 0..=ORDER {
                    for j in 0..=ORDER - i {
                        plane[i][j] += line[i] * v[j];
                    }
                }
            }
            let w = if D == 2 {
                &[1.0, 0.0, 0.0]
            } else {
                &self.pieces[D - 1][last as usize]
            };
            let depth = if D == 2 { 0 } else { ORDER };
            for i in 0..=ORDER {
                for j in 0..=ORDER - i {
                    for k in 0..=depth.min(ORDER - i - j) {
                        total[i][j][k] += plane[i][j] * w[k];
                    }
                }
            }
        }
        moments_to_jet::<D, ORDER>(&total)
    }
}

/// The jet whose derivative of order (i, j, k) along the axes is `m[i][j][k]`.
#[inline]
pub fn moments_to_jet<const D: usize, const ORDER: usize>(m: &[[[f64; 3]; 3]; 3]) -> Jet<D> {
    let at = |a: usize, b: usize| {
        let order = |axis: usize| usize::from(a == axis) + usize::from(b == axis);
        m[order(0)][order(1)][order(2)]
    };
    let mut jet = Jet::ZERO;
    jet.value = m[0][0][0];
    for a in 0..D {
        if ORDER >= 1 {
            jet.gradient[a] = at(a, usize::MAX);
        }
        if ORDER >= 2 {
            for b in 0..D {
                jet.hessian[a][b] = at(a, b);
            }
        }
    }
    jet
}

/// Quotient N / W with derivatives up to `ORDER`.
#[inline]
pub fn quotient<const D: usize, const ORDER: usize>(n: &Jet<D>, w: &Jet<D>) -> Jet<D> {
    let inverse = 1.0 / w.value;
    let mut f = Jet::ZERO;
    f.value = n.value * inverse;
    if ORDER >= 1 {
        for a in 0..D {
            f.gradient[a] = (n.gradient[a] - f.value * w.gradient[a]) * inverse;
        }
    }
    if ORDER >= 2 {
        for a in 0..D {
            for c in 0..D {
                f.hessian[a][c] = (n.hessian[a][c]
                    - f.value * w.hessian[a][c]
                    - f.gradient[a] * w.gradient[c]
                    - f.gradient[c] * w.gradient[a])
                    * inverse;
            }
        }
    }
    f
}

#[inline]
fn accumulate<const D: usize, const ORDER: usize>(sum: &mut Jet<D>, weight: f64, b: &Jet<D>) {
    sum.value += weight * b.value;
    if ORDER >= 1 {
        for a in 0..D {
            sum.gradient[a] += weight * b.gradient[a];
        }
    }
    if ORDER >= 2 {
        for a in 0..D {
            for c in 0..D {
                sum.hessian[a][c] += weight * b.hessian[a][c];
            }
        }
    }
}

/// The field with coefficients `c` at a point, derivatives up to `ORDER`; `Jet::OUTSIDE` outside the box.
#[inline]
pub fn field_at<const D: usize, const ORDER: usize>(
    mesh: &TMesh<D>,
    scratch: &mut Scratch<D>,
    c: &[f64],
    x: &[f64; D],
) -> Jet<D> {
    let elements = mesh.elements();
    match elements.locate(mesh.tree(), x) {
        None => Jet::OUTSIDE,
        Some(e) => field_on::<D, ORDER>(elements, e, scratch, c, x),
    }
}

/// As `field_at`, on a known element.
pub fn field_on<const D: usize, const ORDER: usize>(
    elements: &Elements<D>,
    element: usize,
    scratch: &mut Scratch<D>,
    c: &[f64],
    x: &[f64; D],
) -> Jet<D> {
    scratch.load(elements, element, x);
    let factors = scratch.factors();
    let n = scratch.sum::<ORDER>(factors, |i| c[i as usize]);
    if scratch.local.unity() {
        return n;
    }
    quotient::<D, ORDER>(&n, &scratch.sum::<ORDER>(factors, |_| 1.0))
}

/// The normalised basis functions b_i = B_i / sum B on an element at `x`, in the order of the element's factors.
pub fn basis_on<const D: usize, const ORDER: usize>(
    elements: &Elements<D>,
    element: usize,
    scratch: &mut Scratch<D>,
    x: &[f64; D],
    out: &mut Vec<Jet<D>>,
) {
    scratch.load(elements, element, x);
    out.clear();
    let mut w = Jet::ZERO;
    for factor in scratch.factors() {
        let b = scratch.product::<ORDER>(factor.piece);
        accumulate::<D, ORDER>(&mut w, 1.0, &b);
        out.push(b);
    }
    if scratch.local.unity() {
        return;
    }
    for b in out.iter_mut() {
        *b = quotient::<D, ORDER>(b, &w);
    }
}

/// Rows of normalised basis functions at many points, functions ascending in each; a point outside has an empty row.
#[derive(Debug, Clone)]
pub struct BasisRows<const D: usize> {
    pub start: Vec<i64>,
    pub functions: Vec<i64>,
    pub jets: Vec<Jet<D>>,
}

/// The normalised basis functions at many points.
pub fn basis<const D: usize>(mesh: &TMesh<D>, points: &[[f64; D]], order: usize) -> BasisRows<D> {
    let elements = mesh.elements();
    let chunks: Vec<(Vec<i64>, Vec<i64>, Vec<Jet<D>>)> = points
        .par_chunks(CHUNK)
        .map(|xs| {
            let mut scratch = Scratch::new();
            let mut row = Vec::with_capacity(elements.max_factors());
            let mut ranks: Vec<u32> = Vec::with_capacity(elements.max_factors());
            let (mut counts, mut functions, mut jets) =
                (Vec::with_capacity(xs.len()), Vec::new(), Vec::new());
            for x in xs {
                row.clear();
                if let Some(e) = elements.locate(mesh.tree(), x) {
                    match order {
                        0 => basis_on::<D, 0>(elements, e, &mut scratch, x, &mut row),
                        1 => basis_on::<D, 1>(elements, e, &mut scratch, x, &mut row),
                        _ => basis_on::<D, 2>(elements, e, &mut scratch, x, &mut row),
                    }
                    let factors = scratch.factors();
                    ranks.clear();
                    ranks.extend(0..factors.len() as u32);
                    ranks.sort_unstable_by_key(|&k| factors[k as usize].function);
                    functions.extend(ranks.iter().map(|&k| i64::from(factors[k as usize].function)));
                    jets.extend(ranks.iter().map(|&k| row[k as usize]));
                }
                counts.push(row.len() as i64);
            }
            (counts, functions, jets)
        })
        .collect();
    let mut rows = BasisRows {
        start: vec![0],
        functions: Vec::new(),
        jets: Vec::new(),
    };
    let mut end = 0;
    for (counts, functions, jets) in chunks {
        for n in counts {
            end += n;
            rows.start.push(end);
        }
        rows.functions.extend(functions);
        rows.jets.extend(jets);
    }
    rows
}
