//! Bernstein coefficients of a tricubic: bounds of its values, and halves.

use multiversion::multiversion;

/// Entry `16 i + 4 j + k`.
pub type Patch = [f64; 64];

const STRIDE: [usize; 3] = [16, 4, 1];

/// First entries of the 16 lines along an axis.
#[inline(always)]
fn line(axis: usize, l: usize) -> usize {
    match axis {
        0 => l,
        1 => 16 * (l / 4) + l % 4,
        _ => 4 * l,
    }
}

/// Bernstein from monomial coefficients on the unit cube.
#[multiversion(targets("x86_64+avx+avx2"))]
pub fn bernstein(a: &Patch) -> Patch {
    let mut b = *a;
    let third = 1.0 / 3.0;
    for axis in 0..3 {
        let s = STRIDE[axis];
        for l in 0..16 {
            let at = line(axis, l);
            let [a0, a1, a2, a3] = [b[at], b[at + s], b[at + 2 * s], b[at + 3 * s]];
            b[at + s] = a0 + a1 * third;
            b[at + 2 * s] = a0 + (2.0 * a1 + a2) * third;
            b[at + 3 * s] = a0 + a1 + a2 + a3;
        }
    }
    b
}

/// Both halves along an axis (de Casteljau).
#[multiversion(targets("x86_64+avx+avx2"))]
pub fn halves(patch: &Patch, axis: usize) -> [Patch; 2] {
    let (mut low, mut high) = (*patch, *patch);
    let s = STRIDE[axis];
    for l in 0..16 {
        let at = line(axis, l);
        let [b0, b1, b2, b3] = [patch[at], patch[at + s], patch[at + 2 * s], patch[at + 3 * s]];
        let (p, q, r) = (0.5 * (b0 + b1), 0.5 * (b1 + b2), 0.5 * (b2 + b3));
        let (u, v) = (0.5 * (p + q), 0.5 * (q + r));
        let middle = 0.5 * (u + v);
        low[at + s] = p;
        low[at + 2 * s] = u;
        low[at + 3 * s] = middle;
        high[at] = middle;
        high[at + s] = v;
        high[at + 2 * s] = r;
    }
    [low, high]
}

/// Least and largest coefficient: all values on the cube lie between them.
#[multiversion(targets("x86_64+avx+avx2"))]
pub fn bounds(patch: &Patch) -> [f64; 2] {
    let (mut least, mut largest) = ([f64::INFINITY; 4], [f64::NEG_INFINITY; 4]);
    for four in patch.chunks_exact(4) {
        for k in 0..4 {
            least[k] = least[k].min(four[k]);
            largest[k] = largest[k].max(four[k]);
        }
    }
    [
        least.into_iter().fold(f64::INFINITY, f64::min),
        largest.into_iter().fold(f64::NEG_INFINITY, f64::max),
    ]
}

/// Values at the corners; corner k is the upper one along axis a iff bit a of k is 1.
pub fn corners(patch: &Patch) -> [f64; 8] {
    std::array::from_fn(|k| patch[48 * (k & 1) + 12 * (k >> 1 & 1) + 3 * (k >> 2)])
}

/// Values at both ends and the middle of every axis, entry `9 i + 3 j + k`.
pub fn thirds(patch: &Patch) -> [f64; 27] {
    let (mut plane, mut line, mut out) = ([0.0; 48], [0.0; 36], [0.0; 27]);
    let middle = |b: [f64; 4]| 0.125 * (b[0] + b[3]) + 0.375 * (b[1] + b[2]);
    for l in 0..16 {
        plane[l] = patch[l];
        plane[l + 16] = middle([patch[l], patch[l + 16], patch[l + 32], patch[l + 48]]);
        plane[l + 32] = patch[l + 48];
    }
    for i in 0..3 {
        for k in 0..4 {
            let b = std::array::from_fn(|j| plane[16 * i + 4 * j + k]);
            line[12 * i + k] = b[0];
            line[12 * i + 4 + k] = middle(b);
            line[12 * i + 8 + k] = b[3];
        }
    }
    for (o, b) in out.chunks_exact_mut(3).zip(line.chunks_exact(4)) {
        o[0] = b[0];
        o[1] = middle([b[0], b[1], b[2], b[3]]);
        o[2] = b[3];
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    fn value(a: &Patch, x: [f64; 3]) -> f64 {
        (0..64)
            .map(|e| a[e] * x[0].powi(e as i32 / 16) * x[1].powi(e as i32 / 4 % 4) * x[2].powi(e as i32 % 4))
            .sum()
    }

    #[test]
    fn halves_bound_and_interpolate() {
        let a: Patch = std::array::from_fn(|e| (e as f64 * 1.7).sin());
        let whole = bernstein(&a);
        for (e, v) in thirds(&whole).into_iter().enumerate() {
            let x = [e / 9, e / 3 % 3, e % 3].map(|i| 0.5 * i as f64);
            assert!((value(&a, x) - v).abs() < 1e-13);
        }
        for axis in 0..3 {
            for (side, half) in halves(&whole, axis).iter().enumerate() {
                let [least, largest] = bounds(half);
                let mut x = [0.3, 0.6, 0.8];
                x[axis] = 0.5 * (x[axis] + side as f64);
                let v = value(&a, x);
                assert!(least <= v && v <= largest);
                for (k, c) in corners(half).into_iter().enumerate() {
                    let mut p: [f64; 3] = std::array::from_fn(|d| f64::from((k >> d & 1) as u8));
                    p[axis] = 0.5 * (p[axis] + side as f64);
                    assert!((value(&a, p) - c).abs() < 1e-13);
                }
            }
        }
    }
}
