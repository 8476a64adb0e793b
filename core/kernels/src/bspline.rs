//! Univariate cubic B-splines as polynomials on one knot interval, kept once in a table.

use rustc_hash::FxHashMap;

/// Coefficients of a cubic in the local coordinate t of its interval: a0 + a1 t + a2 t^2 + a3 t^3.
pub type Cubic = [f64; 4];

/// The polynomial of the B-spline with knots `knots` on the interval `[lo, hi]`, by the Cox-de Boor recursion carried
/// out on polynomials in t = (x - lo) / (hi - lo). The interval must not be cut by a knot.
pub fn piece(knots: [i64; 5], lo: i64, hi: i64) -> Cubic {
    debug_assert!(lo < hi);
    let h = (hi - lo) as f64;
    // Degree 0: one on the knot interval that holds [lo, hi], zero elsewhere.
    let mut level: Vec<Cubic> = (0..4)
        .map(|i| {
            let active = knots[i] <= lo && hi <= knots[i + 1];
            [f64::from(u8::from(active)), 0.0, 0.0, 0.0]
        })
        .collect();
    for degree in 1..4 {
        level = (0..4 - degree)
            .map(|i| {
                let mut sum = [0.0; 4];
                let rise = knots[i + degree] - knots[i];
                if rise > 0 {
                    let (a, b) = ((lo - knots[i]) as f64 / rise as f64, h / rise as f64);
                    add_linear_product(&mut sum, &level[i], a, b);
                }
                let fall = knots[i + degree + 1] - knots[i + 1];
                if fall > 0 {
                    let (a, b) = (
                        (knots[i + degree + 1] - lo) as f64 / fall as f64,
                        -h / fall as f64,
                    );
                    add_linear_product(&mut sum, &level[i + 1], a, b);
                }
                sum
            })
            .collect();
    }
    level[0]
}

fn add_linear_product(sum: &mut Cubic, p: &Cubic, a: f64, b: f64) {
    for k in 0..4 {
        sum[k] += a * p[k];
        if k < 3 {
            sum[k + 1] += b * p[k];
        }
    }
}

/// Value, first and second derivative of a cubic in its local coordinate.
#[inline]
pub fn jet(p: &Cubic, t: f64) -> [f64; 3] {
    let second = 2.0 * p[2] + 6.0 * p[3] * t;
    let first = p[1] + t * (2.0 * p[2] + 3.0 * p[3] * t);
    let value = p[0] + t * (p[1] + t * (p[2] + t * p[3]));
    [value, first, second]
}

/// Pieces that are equal up to scale and shift share one entry.
#[derive(Debug, Default, Clone)]
pub struct PieceTable {
    pieces: Vec<Cubic>,
    index: FxHashMap<[i64; 6], u32>,
}

impl PieceTable {
    /// Entry of the B-spline with `knots` on `[lo, hi]`, made when it is new.
    pub fn entry(&mut self, knots: [i64; 5], lo: i64, hi: i64) -> u32 {
        let mut key = [0; 6];
        for (k, &knot) in key.iter_mut().zip(&knots) {
            *k = knot - lo;
        }
        key[5] = hi - lo;
        // Knots of a tree differ by powers of two and their sums, so that a shift takes out most of the scale.
        let shift = key.iter().fold(0, |a, &b| a | b).trailing_zeros();
        for k in &mut key {
            *k >>= shift;
        }
        let pieces = &mut self.pieces;
        *self.index.entry(key).or_insert_with(|| {
            pieces.push(piece([key[0], key[1], key[2], key[3], key[4]], 0, key[5]));
            (pieces.len() - 1) as u32
        })
    }

    /// All cubics, by entry.
    pub fn pieces(&self) -> &[Cubic] {
        &self.pieces
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn uniform_pieces_are_the_textbook_cubics() {
        let expected = [
            [0.0, 0.0, 0.0, 1.0 / 6.0],
            [1.0 / 6.0, 0.5, 0.5, -0.5],
            [2.0 / 3.0, 0.0, -1.0, 0.5],
            [1.0 / 6.0, -0.5, 0.5, -1.0 / 6.0],
        ];
        for (k, e) in expected.iter().enumerate() {
            let p = piece([0, 1, 2, 3, 4], k as i64, k as i64 + 1);
            for (a, b) in p.iter().zip(e) {
                assert!((a - b).abs() < 1e-15);
            }
        }
    }

    #[test]
    fn fourfold_boundary_knot_gives_bernstein() {
        let p = piece([0, 0, 0, 0, 1], 0, 1);
        for (a, b) in p.iter().zip([1.0, -3.0, 3.0, -1.0]) {
            assert!((a - b).abs() < 1e-15);
        }
    }

    #[test]
    fn scaled_and_shifted_pieces_share_an_entry() {
        let mut table = PieceTable::default();
        let a = table.entry([0, 1, 2, 4, 6], 2, 4);
        let b = table.entry([100, 108, 116, 132, 148], 116, 132);
        assert_eq!(a, b);
        assert_eq!(table.pieces().len(), 1);
    }
}
