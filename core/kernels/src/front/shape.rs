//! Curvatures at active nodes: central differences for kappa, differences of normals for the principal ones.

use crate::grid::Blocks;

use super::upwind::Stencil;

/// Gradient and Hessian by central differences.
pub struct Derivatives<const D: usize> {
    pub gradient: [f64; D],
    pub hessian: [[f64; D]; D],
}

impl<const D: usize> Stencil<'_, D> {
    /// Central differences over the 9 or 19 nodes around one.
    #[inline(always)]
    pub fn derivatives(&self, slot: usize, offset: usize) -> Derivatives<D> {
        let f = self.values[slot * Blocks::<D>::VOLUME + offset];
        let mut out = Derivatives {
            gradient: [0.0; D],
            hessian: [[0.0; D]; D],
        };
        for a in 0..D {
            let h = self.spacing[a];
            let (m, p) = (self.beside(slot, offset, a, -1), self.beside(slot, offset, a, 1));
            out.gradient[a] = (p - m) / (2.0 * h);
            out.hessian[a][a] = (p - 2.0 * f + m) / (h * h);
            for b in a + 1..D {
                let corner =
                    |s: isize, t: isize| self.blocks.diagonal(self.values, slot, offset, [a, b], [s, t]);
                let mixed = corner(1, 1) - corner(1, -1) - corner(-1, 1) + corner(-1, -1);
                let mixed = mixed / (4.0 * h * self.spacing[b]);
                out.hessian[a][b] = mixed;
                out.hessian[b][a] = mixed;
            }
        }
        out
    }
}

impl<const D: usize> Derivatives<D> {
    pub fn square(&self) -> f64 {
        self.gradient.iter().map(|g| g * g).sum()
    }

    /// kappa = div (grad f / |grad f|) = k1 + k2; 0 where the gradient vanishes.
    #[inline(always)]
    pub fn curvature(&self) -> f64 {
        let (g, h) = (&self.gradient, &self.hessian);
        let square = self.square();
        if square <= f64::MIN_POSITIVE {
            return 0.0;
        }
        let mut sum = 0.0;
        for a in 0..D {
            sum += h[a][a] * (square - g[a] * g[a]);
            for b in a + 1..D {
                sum -= 2.0 * g[a] * g[b] * h[a][b];
            }
        }
        sum / (square * square.sqrt())
    }

    /// k1 k2 of a surface; 0 in the plane.
    #[inline(always)]
    pub fn gauss(&self) -> f64 {
        if D == 2 {
            return 0.0;
        }
        let (g, h) = (&self.gradient, &self.hessian);
        let square = self.square();
        if square <= f64::MIN_POSITIVE {
            return 0.0;
        }
        // g . adj(H) g over |g|^4.
        let mut sum = 0.0;
        for a in 0..D {
            let (b, c) = ((a + 1) % D, (a + 2) % D);
            sum += g[a] * g[a] * (h[b][b] * h[c][c] - h[b][c] * h[b][c]);
            sum += 2.0 * g[a] * g[b] * (h[a][c] * h[b][c] - h[a][b] * h[c][c]);
        }
        sum / (square * square)
    }

    /// kappa where the normal through this node meets the zero set, `distance` away: k / (1 - distance k) for each
    /// principal curvature k. Without that the nodes on the two sides would move apart.
    #[inline(always)]
    pub fn curvature_at_zero(&self, distance: f64) -> f64 {
        let (kappa, gauss) = (self.curvature(), self.gauss());
        // sum of k_i / (1 - d k_i) with both over the product of the denominators.
        let denominator = 1.0 - distance * kappa + distance * distance * gauss;
        if denominator < 0.25 {
            // Within a focal point: f is no distance there.
            return kappa;
        }
        (kappa - 2.0 * distance * gauss) / denominator
    }
}

impl<const D: usize> Stencil<'_, D> {
    /// Principal curvatures, larger first, and |grad f|: differences of the normals half a node away along each axis,
    /// B = N (I - n n^T), k1 + k2 = Tr B and k1^2 + k2^2 = |B|_F^2 (EDT, appendix B).
    pub fn principal(&self, slot: usize, offset: usize) -> ([f64; 2], f64) {
        let here = self.gradient(slot, offset);
        let norm = here.iter().map(|g| g * g).sum::<f64>().sqrt();
        if norm <= f64::MIN_POSITIVE {
            return ([0.0; 2], norm);
        }
        let n = here.map(|g| g / norm);
        let mut change = [[0.0; D]; D];
        for b in 0..D {
            let [below, above] = [-1, 1].map(|step| self.halfway(slot, offset, b, step, &here));
            for a in 0..D {
                change[a][b] = (above[a] - below[a]) / self.spacing[b];
            }
        }
        let (mut trace, mut frobenius) = (0.0, 0.0);
        for a in 0..D {
            let along: f64 = (0..D).map(|b| change[a][b] * n[b]).sum();
            for b in 0..D {
                let entry = change[a][b] - along * n[b];
                frobenius += entry * entry;
                trace += if a == b { entry } else { 0.0 };
            }
        }
        if D == 2 {
            return ([trace, 0.0], norm);
        }
        let spread = (0.5 * frobenius - 0.25 * trace * trace).max(0.0).sqrt();
        ([0.5 * trace + spread, 0.5 * trace - spread], norm)
    }

    /// Normal half a node away along axis b.
    fn halfway(&self, slot: usize, offset: usize, b: usize, step: isize, here: &[f64; D]) -> [f64; D] {
        let f = self.values[slot * Blocks::<D>::VOLUME + offset];
        let mut g = [0.0; D];
        for a in 0..D {
            g[a] = if a == b {
                step as f64 * (self.beside(slot, offset, b, step) - f) / self.spacing[b]
            } else {
                let corner = |s: isize| self.blocks.diagonal(self.values, slot, offset, [a, b], [s, step]);
                0.5 * (here[a] + (corner(1) - corner(-1)) / (2.0 * self.spacing[a]))
            };
        }
        let norm = g.iter().map(|x| x * x).sum::<f64>().sqrt().max(f64::MIN_POSITIVE);
        g.map(|x| x / norm)
    }
}
