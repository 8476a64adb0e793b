//! Basis functions at the `2^D` Gauss points of an element, all points side by side.

use crate::bspline::jet;
use crate::element::{Elements, Factor};
use crate::local::Local;

/// One number a Gauss point; the first `2^D` count. Point l lies on the upper side along axis a iff bit a of l is 1.
pub type Lanes = [f64; 8];

/// Value and gradient of a function at the Gauss points: `[B, dB/dx_0, ...]`.
pub type Slopes = [Lanes; 4];

/// Places of the two Gauss points on the unit interval.
pub fn gauss_points() -> [f64; 2] {
    let offset = 0.5 / 3.0_f64.sqrt();
    [0.5 - offset, 0.5 + offset]
}

/// Scratch of one thread: an element, and value and derivative of an element's univariate pieces at the Gauss points. 256 places an axis
/// make every `u8` a valid index.
pub struct Gauss<const D: usize> {
    local: Local<D>,
    pieces: Box<[[[Lanes; 2]; 256]; D]>,
}

impl<const D: usize> Default for Gauss<D> {
    fn default() -> Self {
        Self::new()
    }
}

// The array goes to the heap at once, and fits on any thread's stack on the way.
#[allow(clippy::large_stack_arrays)]
impl<const D: usize> Gauss<D> {
    pub fn new() -> Self {
        Self {
            local: Local::new(),
            pieces: Box::new([[[[0.0; 8]; 2]; 256]; D]),
        }
    }

    /// Evaluate the element's pieces.
    pub fn load(&mut self, elements: &Elements<D>, element: usize) {
        let points = gauss_points();
        self.local.load(elements, element);
        let inverse = self.local.head().inverse;
        for (a, axis) in self.pieces.iter_mut().enumerate() {
            for (slot, cubic) in axis.iter_mut().zip(self.local.pieces(a)) {
                let [low, high] = points.map(|t| jet(cubic, t));
                for l in 0..1 << D {
                    let [value, slope, _] = if (l >> a) & 1 == 1 { high } else { low };
                    slot[0][l] = value;
                    slot[1][l] = slope * inverse[a];
                }
            }
        }
    }

    /// Basis functions on the element.
    pub fn factors(&self) -> &[Factor<D>] {
        self.local.factors()
    }

    /// Unnormalised B_i and its gradient at all points.
    #[inline(always)]
    pub fn product(&self, factor: &Factor<D>) -> Slopes {
        let u: [&[Lanes; 2]; D] = std::array::from_fn(|a| &self.pieces[a][factor.piece[a] as usize]);
        let mut out = [[0.0; 8]; 4];
        for (k, out) in out.iter_mut().take(D + 1).enumerate() {
            // Entry k > 0 is differentiated along axis k - 1.
            let v: [&Lanes; D] = std::array::from_fn(|a| &u[a][usize::from(a + 1 == k)]);
            for l in 0..1 << D {
                out[l] = if D == 2 {
                    v[0][l] * v[1][l]
                } else {
                    v[0][l] * v[1][l] * v[D - 1][l]
                };
            }
        }
        out
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::evaluate::{Jet, Scratch};
    use crate::mesh::TMesh;
    use crate::refine::from_points;

    fn agrees_with_single_points<const D: usize>(mesh: &TMesh<D>) {
        let elements = mesh.elements();
        let (mut gauss, mut scratch) = (Gauss::new(), Scratch::new());
        let scale = f64::from(1_u32 << mesh.depth());
        for e in 0..elements.len() {
            gauss.load(elements, e);
            let (corner, side) = elements.frame(e);
            for l in 0..1 << D {
                let x = std::array::from_fn(|a| corner[a] + side[a] * gauss_points()[(l >> a) & 1]);
                scratch.load(elements, e, &x);
                for factor in scratch.factors() {
                    let slopes = gauss.product(factor);
                    let jet: Jet<D> = scratch.product::<1>(factor.piece);
                    assert!((slopes[0][l] - jet.value).abs() < 1e-13);
                    assert!((0..D).all(|a| (slopes[1 + a][l] - jet.gradient[a]).abs() < 1e-13 * scale));
                }
            }
        }
    }

    #[test]
    fn points_side_by_side_agree_with_single_ones() {
        agrees_with_single_points(&from_points(&[[0.31, 0.62], [0.8, 0.2]], &[6, 5], 1, 2, 100_000).unwrap());
        agrees_with_single_points(&from_points(&[[0.31, 0.62, 0.4]], &[3], 1, 1, 100_000).unwrap());
    }
}
