//! Where a planar T-spline may vanish, by the signs of Bernstein coefficients.

use crate::mesh::TMesh;
use crate::polynomial::Quotient;
use crate::tree::{Leaf, SIDE};

/// Bernstein coefficients of a bicubic, entry `4 i + j`.
type Patch = [f64; 16];

/// Coefficients this small against the largest may have the wrong sign.
const ROUNDING: f64 = 1e-12;

/// Of the `2^subdivision` squares an axis of a leaf, row by row, push those in which the field may vanish. A square that
/// is left out has one sign on its whole closure, so that its neighbours cannot disagree about their common side.
pub fn live_squares(
    mesh: &TMesh<2>,
    quotient: &mut Quotient<2>,
    c: &[f64],
    leaf: usize,
    subdivision: u8,
    out: &mut Vec<Leaf<2>>,
) {
    let cell = mesh.tree().leaves()[leaf];
    let n = 1_usize << subdivision;
    let mut live = vec![true; n * n];
    let range = mesh.elements().of_leaf(leaf);
    // Leaves that knots cut are few, and away from the zero set where meshes are graded around it.
    if range.len() == 1 {
        quotient.load(mesh.elements(), range.start, c);
        let patch = bernstein(&quotient.numerator()[..16]);
        let margin = ROUNDING * patch.iter().fold(0.0, |m: f64, b| m.max(b.abs()));
        // The border closes the shape: there only positive squares are without a line.
        let border = cell.corner.iter().any(|&x| x == 0 || x + cell.side() == SIDE);
        let below = if border { f64::NEG_INFINITY } else { -margin };
        live.fill(false);
        mark(&patch, [below, margin], [0, 0], n, n, &mut live);
    }
    let side = cell.side() >> subdivision;
    for k in (0..n * n).filter(|&k| live[k]) {
        let corner = [
            cell.corner[0] + (k % n) as u32 * side,
            cell.corner[1] + (k / n) as u32 * side,
        ];
        out.push(Leaf {
            corner,
            level: cell.level + subdivision,
        });
    }
}

/// Mark the squares of a block, `width` of them an axis, unless its coefficients all lie beyond one of the limits.
fn mark(patch: &Patch, limits: [f64; 2], at: [usize; 2], width: usize, n: usize, live: &mut [bool]) {
    if patch.iter().all(|&b| b > limits[1]) || patch.iter().all(|&b| b < limits[0]) {
        return;
    }
    if width == 1 {
        live[at[0] + n * at[1]] = true;
        return;
    }
    let half = width / 2;
    for (x, part) in halves(patch, 4, 1).iter().enumerate() {
        for (y, quarter) in halves(part, 1, 4).iter().enumerate() {
            mark(
                quarter,
                limits,
                [at[0] + x * half, at[1] + y * half],
                half,
                n,
                live,
            );
        }
    }
}

/// Both halves of a patch along the axis whose coefficients lie `stride` apart (de Casteljau); `other` is the other
/// axis's stride.
fn halves(patch: &Patch, stride: usize, other: usize) -> [Patch; 2] {
    let (mut low, mut high) = (*patch, *patch);
    for k in 0..4 {
        let at = |i: usize| k * other + i * stride;
        let b: [f64; 4] = std::array::from_fn(|i| patch[at(i)]);
        let (p, q, r) = (0.5 * (b[0] + b[1]), 0.5 * (b[1] + b[2]), 0.5 * (b[2] + b[3]));
        let (s, t) = (0.5 * (p + q), 0.5 * (q + r));
        let middle = 0.5 * (s + t);
        for (i, (l, h)) in [b[0], p, s, middle]
            .into_iter()
            .zip([middle, t, r, b[3]])
            .enumerate()
        {
            low[at(i)] = l;
            high[at(i)] = h;
        }
    }
    [low, high]
}

/// Bernstein from monomial coefficients on the unit square.
fn bernstein(a: &[f64]) -> Patch {
    let line = |a: [f64; 4]| {
        let third = 1.0 / 3.0;
        [
            a[0],
            a[0] + a[1] * third,
            a[0] + (2.0 * a[1] + a[2]) * third,
            a[0] + a[1] + a[2] + a[3],
        ]
    };
    let mut patch = [0.0; 16];
    for j in 0..4 {
        for (i, b) in line(std::array::from_fn(|i| a[4 * i + j]))
            .into_iter()
            .enumerate()
        {
            patch[4 * i + j] = b;
        }
    }
    for i in 0..4 {
        let row = line(std::array::from_fn(|j| patch[4 * i + j]));
        patch[4 * i..4 * i + 4].copy_from_slice(&row);
    }
    patch
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::evaluate::{field_at, Scratch};

    /// Every square in which a lattice of values changes sign is found.
    #[test]
    fn no_square_with_a_change_of_sign_is_left_out() {
        let mesh = TMesh::<2>::uniform(3).unwrap();
        let c: Vec<f64> = (0..mesh.num_functions())
            .map(|i| (i as f64 * 2.3).sin() + 0.2)
            .collect();
        let (mut quotient, mut scratch) = (Quotient::new(), Scratch::new());
        for leaf in 0..mesh.num_cells() {
            let mut found = Vec::new();
            live_squares(&mesh, &mut quotient, &c, leaf, 2, &mut found);
            let cell = mesh.tree().leaves()[leaf];
            for k in 0..16 {
                let side = cell.side() / 4;
                let corner = [cell.corner[0] + k % 4 * side, cell.corner[1] + k / 4 * side];
                let mut signs = [false; 2];
                for i in 0..36 {
                    let step = [i % 6, i / 6].map(|s| f64::from(s) / 5.0 * f64::from(side));
                    let x = std::array::from_fn(|a| (f64::from(corner[a]) + step[a]) / f64::from(SIDE));
                    let value = field_at::<2, 0>(&mesh, &mut scratch, &c, &x).value;
                    signs[usize::from(value < 0.0)] = true;
                }
                let listed = found.iter().any(|s| s.corner == corner);
                assert!(listed || signs != [true; 2], "leaf {leaf} square {k}");
            }
        }
    }
}
