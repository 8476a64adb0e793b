//! Values of the layers: distances from the layers within.

use super::mask::{has, Mask};
use super::upwind::Stencil;
use crate::grid::Blocks;

/// A known neighbour of a node: values are measured away from the zero set.
#[derive(Clone, Copy)]
struct Known {
    /// The difference quotient is `slope * (u - base)`.
    slope: f64,
    base: f64,
    /// Value of the neighbour itself.
    value: f64,
}

impl<const D: usize> Stencil<'_, D> {
    /// Distance of a node with |grad u| = 1 from its nearer neighbours, u = f outside and -f inside: differences of
    /// second order (third where three nodes lie behind one another) away from the zero set. None without neighbours
    /// that have a value.
    pub fn eikonal(&self, slot: usize, offset: usize, outside: bool) -> Option<f64> {
        let sign = if outside { 1.0 } else { -1.0 };
        let far = self.blocks.far();
        let mut known = [Known {
            slope: 0.0,
            base: 0.0,
            value: f64::INFINITY,
        }; D];
        for (a, known) in known.iter_mut().enumerate() {
            let below = sign * self.beside(slot, offset, a, -1);
            let above = sign * self.beside(slot, offset, a, 1);
            let (u1, step) = if below <= above { (below, -1) } else { (above, 1) };
            if u1.abs() >= far {
                continue;
            }
            let h = self.spacing[a];
            let u2 = sign * self.beside(slot, offset, a, 2 * step);
            *known = Known {
                slope: 1.0 / h,
                base: u1,
                value: u1,
            };
            if u2.abs() < far && u2 <= u1 {
                let u3 = sign * self.beside(slot, offset, a, 3 * step);
                (known.slope, known.base) = if u3.abs() < far && u3 <= u2 {
                    (11.0 / (6.0 * h), (18.0 * u1 - 9.0 * u2 + 2.0 * u3) / 11.0)
                } else {
                    (1.5 / h, (4.0 * u1 - u2) / 3.0)
                };
            }
        }
        solve(&mut known)
    }

    /// Whitaker's layers: one node further than the nearest neighbour within.
    pub fn city_block(
        &self,
        slot: usize,
        offset: usize,
        inner: &[[Mask; 2]; D],
        outside: bool,
    ) -> Option<f64> {
        let sign = if outside { 1.0 } else { -1.0 };
        let mut least = None;
        for a in 0..D {
            for (side, step) in [(0, -1), (1, 1)] {
                if has(&inner[a][side], offset) {
                    let u = sign * self.beside(slot, offset, a, step) + self.spacing[a];
                    least = Some(least.map_or(u, |l: f64| l.min(u)));
                }
            }
        }
        least
    }

    /// Change of a layer's node: that of its neighbours within, weighted by how much of the normal points to each, so
    /// that it is constant along normals. `before` and the stencil's values are those before and after the change.
    #[inline(always)]
    pub fn carried(
        &self,
        before: &[f64],
        slot: usize,
        offset: usize,
        inner: &[[Mask; 2]; D],
        outside: bool,
    ) -> Option<f64> {
        let sign = if outside { 1.0 } else { -1.0 };
        let own = sign * before[slot * Blocks::<D>::VOLUME + offset];
        let (mut sum, mut weight) = (0.0, 0.0);
        let mut nearest = (f64::INFINITY, 0.0);
        for a in 0..D {
            let mut best = (f64::INFINITY, 0);
            for (side, step) in [(0, -1), (1, 1)] {
                if has(&inner[a][side], offset) {
                    let u = sign * self.blocks.beside(before, slot, offset, a, step);
                    if u < best.0 {
                        best = (u, step);
                    }
                }
            }
            let (u, step) = best;
            if step != 0 {
                let change = self.beside(slot, offset, a, step) - sign * u;
                let w = (own - u).max(0.0) / (self.spacing[a] * self.spacing[a]);
                sum += w * change;
                weight += w;
                if u < nearest.0 {
                    nearest = (u, change);
                }
            }
        }
        if weight > 0.0 {
            Some(sum / weight)
        } else {
            nearest.0.is_finite().then_some(nearest.1)
        }
    }
}

/// The u with sum of `(slope (u - base))^2` = 1 over the neighbours that lie below it.
#[inline(always)]
fn solve<const D: usize>(known: &mut [Known; D]) -> Option<f64> {
    // Three entries at most: a bubble sort is a few exchanges.
    for last in (1..D).rev() {
        for k in 0..last {
            if known[k + 1].value < known[k].value {
                known.swap(k, k + 1);
            }
        }
    }
    let mut u = f64::INFINITY;
    let (mut a, mut b, mut c) = (0.0, 0.0, -1.0);
    for k in known.iter() {
        if u <= k.value || k.value == f64::INFINITY {
            break;
        }
        let s = k.slope * k.slope;
        a += s;
        b += s * k.base;
        c += s * k.base * k.base;
        let discriminant = b * b - a * c;
        if discriminant < 0.0 {
            break;
        }
        u = (b + discriminant.sqrt()) / a;
    }
    (u < f64::INFINITY).then_some(u)
}
