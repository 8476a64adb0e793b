//! One stage of a step: the active nodes move, the layers follow.

use rayon::prelude::*;

use super::mask::{all_beside, is_empty, offsets, union, Mask};
use super::upwind::{advected, godunov};
use super::{Front, Order};
use crate::error::{KernelError, Result};
use crate::grid::Blocks;

/// Speed at the samples, term by term: v = normal + advection . n - smoothing kappa.
#[derive(Clone, Copy)]
pub struct Terms<'a, const D: usize> {
    pub normal: &'a [f64],
    pub advection: Option<&'a [[f64; D]]>,
    pub smoothing: Option<&'a [f64]>,
}

impl<const D: usize> Front<D> {
    /// Move the zero set for `step` with `terms` at the samples of the same stage; nothing changes for good until
    /// `commit`. The second stage averages with the first (Heun). Returns the largest change of an active node since the
    /// last `commit`, in the smallest spacings, and the root mean square, in units of the spacing.
    pub fn advance(&mut self, terms: Terms<'_, D>, step: f64, staged: bool) -> Result<(f64, f64)> {
        self.check(&terms)?;
        let mut scratch = std::mem::take(&mut self.scratch);
        let before = self.blocks.values();
        let stencil = self.stencil(staged);
        let order = self.order;
        let value = |number: usize, slot: usize, offset: usize| {
            let sides = match order {
                Order::First => stencil.first_order(slot, offset),
                Order::Second => stencil.second_order(slot, offset),
            };
            let v = terms.normal[number];
            let mut rate = if v == 0.0 { 0.0 } else { v * godunov(&sides, v) };
            if let Some(velocity) = terms.advection {
                rate += advected(&sides, &velocity[number]);
            }
            if let Some(weight) = terms.smoothing {
                if weight[number] != 0.0 {
                    let derivatives = stencil.derivatives(slot, offset);
                    let norm = derivatives.square().sqrt();
                    let f = stencil.values[slot * Blocks::<D>::VOLUME + offset];
                    rate -= weight[number] * derivatives.curvature_at_zero(f / norm.max(0.5)) * norm;
                }
            }
            let f = before[slot * Blocks::<D>::VOLUME + offset];
            let now = stencil.values[slot * Blocks::<D>::VOLUME + offset];
            if staged {
                0.5 * (f + now - step * rate)
            } else {
                f - step * rate
            }
        };
        let changes: Vec<(f64, f64)> = scratch
            .par_chunks_mut(Blocks::<D>::VOLUME)
            .enumerate()
            .map(|(slot, out)| {
                let (mut most, mut square) = (0.0_f64, 0.0);
                for (k, offset) in offsets(self.active(slot)).enumerate() {
                    let new = value(self.first[slot] + k, slot, offset);
                    let change = (new - before[slot * Blocks::<D>::VOLUME + offset]).abs();
                    most = most.max(change);
                    square += change * change;
                    out[offset] = new;
                }
                (most, square)
            })
            .collect();
        self.scratch = scratch;
        let smallest = self.spacing.iter().fold(f64::INFINITY, |m, &h| m.min(h));
        let (mut largest, mut sum) = (0.0_f64, 0.0);
        for (most, square) in changes {
            largest = largest.max(most);
            sum += square;
        }
        self.spread(0, false);
        if order == Order::Second {
            // A stage is looked at up to two nodes from the active ones, its end everywhere.
            self.carry(if staged { self.layers } else { 2 });
        }
        self.moved = largest / smallest;
        Ok((largest / smallest, (sum / self.len().max(1) as f64).sqrt()))
    }

    /// Drop what a stage did.
    pub fn undo(&mut self) {
        self.moved = 0.0;
        super::layers::copy(self.blocks.values(), &mut self.work);
    }

    fn check(&self, terms: &Terms<'_, D>) -> Result<()> {
        let n = self.len();
        let lengths = [
            Some(terms.normal.len()),
            terms.advection.map(<[_]>::len),
            terms.smoothing.map(<[_]>::len),
        ];
        if lengths.iter().flatten().any(|&l| l != n) {
            return Err(KernelError::Invalid(format!(
                "terms: found lengths {lengths:?}, accepted are {n}"
            )));
        }
        let finite = terms.normal.iter().all(|v| v.is_finite())
            && terms.smoothing.is_none_or(|s| s.iter().all(|v| v.is_finite()))
            && terms
                .advection
                .is_none_or(|a| a.iter().flatten().all(|v| v.is_finite()));
        if finite {
            Ok(())
        } else {
            Err(KernelError::Invalid(
                "speed: found NaN or infinity, accepted are finite numbers".into(),
            ))
        }
    }

    /// Carry the change of the active nodes outward to layer `last`.
    fn carry(&mut self, last: usize) {
        let kinds = self.kinds();
        let mut inner: Vec<Mask> = self.members.chunks(kinds).map(|m| m[0]).collect();
        for k in 1..=last {
            let mut scratch = std::mem::take(&mut self.scratch);
            {
                let before = self.blocks.values();
                let stencil = self.stencil(true);
                scratch
                    .par_chunks_mut(Blocks::<D>::VOLUME)
                    .enumerate()
                    .for_each(|(slot, out)| {
                        let members = &self.members[slot * kinds..(slot + 1) * kinds];
                        if is_empty(&members[Self::kind(k, true)]) && is_empty(&members[Self::kind(k, false)])
                        {
                            return;
                        }
                        let sides = all_beside(&self.blocks, &inner, slot);
                        for outside in [true, false] {
                            for offset in offsets(&members[Self::kind(k, outside)]) {
                                let old = before[slot * Blocks::<D>::VOLUME + offset];
                                let change = stencil.carried(before, slot, offset, &sides, outside);
                                out[offset] = old + change.unwrap_or(0.0);
                            }
                        }
                    });
            }
            self.scratch = scratch;
            self.spread(k, false);
            for (inner, members) in inner.iter_mut().zip(self.members.chunks(kinds)) {
                *inner = union(
                    inner,
                    &union(&members[Self::kind(k, true)], &members[Self::kind(k, false)]),
                );
            }
        }
    }
}
