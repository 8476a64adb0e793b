//! What the terms of a speed make of the field at an active node.

use crate::grid::Blocks;

/// The nodes around an active one that a term needs, and how they are read.
pub struct Stencil<'a, const D: usize> {
    pub blocks: &'a Blocks<D>,
    pub values: &'a [f64],
    pub spacing: &'a [f64; D],
}

/// First differences below and above a node, one pair an axis.
pub type OneSided<const D: usize> = [[f64; 2]; D];

impl<const D: usize> Stencil<'_, D> {
    #[inline(always)]
    pub fn beside(&self, slot: usize, offset: usize, axis: usize, step: isize) -> f64 {
        self.blocks.beside(self.values, slot, offset, axis, step)
    }

    /// Differences to the next node on either side.
    #[inline(always)]
    pub fn first_order(&self, slot: usize, offset: usize) -> OneSided<D> {
        let f = self.values[slot * Blocks::<D>::VOLUME + offset];
        std::array::from_fn(|a| {
            let h = self.spacing[a];
            let (m, p) = (self.beside(slot, offset, a, -1), self.beside(slot, offset, a, 1));
            [(f - m) / h, (p - f) / h]
        })
    }

    /// Second-order differences that choose the smoother side (ENO).
    #[inline(always)]
    pub fn second_order(&self, slot: usize, offset: usize) -> OneSided<D> {
        let f = self.values[slot * Blocks::<D>::VOLUME + offset];
        std::array::from_fn(|a| {
            let h = self.spacing[a];
            let (m, p) = (self.beside(slot, offset, a, -1), self.beside(slot, offset, a, 1));
            let (mm, pp) = (self.beside(slot, offset, a, -2), self.beside(slot, offset, a, 2));
            let here = p - 2.0 * f + m;
            let (below, above) = (f - 2.0 * m + mm, pp - 2.0 * p + f);
            [
                (f - m + 0.5 * smaller(here, below)) / h,
                (p - f - 0.5 * smaller(here, above)) / h,
            ]
        })
    }

    /// Central differences.
    #[inline(always)]
    pub fn gradient(&self, slot: usize, offset: usize) -> [f64; D] {
        std::array::from_fn(|a| {
            let (m, p) = (self.beside(slot, offset, a, -1), self.beside(slot, offset, a, 1));
            (p - m) / (2.0 * self.spacing[a])
        })
    }
}

/// The one of smaller magnitude.
#[inline(always)]
fn smaller(a: f64, b: f64) -> f64 {
    if a.abs() <= b.abs() {
        a
    } else {
        b
    }
}

/// |grad f| for a motion with normal speed `v`: Godunov's choice of the sides that the front comes from.
#[inline(always)]
pub fn godunov<const D: usize>(sides: &OneSided<D>, v: f64) -> f64 {
    let mut square = 0.0;
    for [below, above] in sides {
        let (a, b) = if v > 0.0 {
            (below.max(0.0), above.min(0.0))
        } else {
            (below.min(0.0), above.max(0.0))
        };
        square += (a * a).max(b * b);
    }
    square.sqrt()
}

/// V . grad f, each axis from where the velocity comes.
#[inline(always)]
pub fn advected<const D: usize>(sides: &OneSided<D>, velocity: &[f64]) -> f64 {
    (0..D)
        .map(|a| velocity[a] * sides[a][usize::from(velocity[a] <= 0.0)])
        .sum()
}
