//! The sparse field: a level set of which only the nodes near its zero set are kept and moved.
//!
//! The active layer L0 holds the nodes with |f| <= h / 2; layers L+1, L-1, L+2, ... are the nodes one, two, ... steps
//! from it. Speeds belong to the active nodes, each taken where its normal meets the zero set. Whitaker's scheme
//! (first order) gives the layers city-block distances; the accurate one carries the change of the active layer outward
//! along the normals, so that a distance stays a distance, and solves |grad f| = 1 for nodes that are new.

mod check;
mod distance;
mod layers;
mod mask;
mod samples;
mod shape;
mod step;
mod upwind;

pub use samples::Samples;
pub use step::Terms;

use rayon::prelude::*;

use crate::error::{KernelError, Result};
use crate::grid::Blocks;
use mask::{count, Mask, EMPTY};

/// Accuracy of space and time.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Order {
    /// Whitaker's scheme: first-order differences, one-stage steps, layers one apart.
    First,
    /// Second-order differences, two-stage steps, layers of distances.
    Second,
}

/// A level set in motion.
pub struct Front<const D: usize> {
    blocks: Blocks<D>,
    /// Values at the end of the stage that is under way; else those of `blocks`.
    work: Vec<f64>,
    scratch: Vec<f64>,
    spacing: [f64; D],
    /// Bound of the active layer's values: half the largest spacing.
    half: f64,
    layers: usize,
    order: Order,
    /// Members of L0, L+1, L-1, L+2, ...: `2 layers + 1` masks a slot.
    members: Vec<Mask>,
    /// Union of these.
    covered: Vec<Mask>,
    /// Those that have joined in this step.
    fresh: Vec<Mask>,
    /// Number of the first active node of each slot, and of all.
    first: Vec<usize>,
    /// Spacings that the zero set may have moved since the layers were last made distances.
    travelled: f64,
    /// The same for the stages under way.
    moved: f64,
}

impl<const D: usize> Front<D> {
    /// The front of a field whose values near the zero set are about distances.
    pub fn new(blocks: &Blocks<D>, spacing: [f64; D], layers: usize, order: Order) -> Result<Self> {
        if spacing.iter().any(|h| !h.is_finite() || *h <= 0.0) {
            return Err(KernelError::Invalid(format!(
                "spacing: found {spacing:?}, accepted are positive lengths"
            )));
        }
        let least = if order == Order::First { 2 } else { 3 };
        if layers < least || layers > 8 {
            return Err(KernelError::Invalid(format!(
                "layers: found {layers}, accepted are {least} to 8"
            )));
        }
        let largest = spacing.iter().fold(0.0_f64, |m, &h| m.max(h));
        let far = (layers as f64 + 1.0) * largest;
        if blocks.values().par_iter().any(|v| v.is_nan()) {
            return Err(KernelError::Invalid(
                "values: found NaN, accepted are numbers".into(),
            ));
        }
        let mut own = Self {
            // What the field's own band cut off is unknown.
            blocks: blocks.narrowed(blocks.far() * (1.0 - 1e-9), far)?,
            work: Vec::new(),
            scratch: Vec::new(),
            spacing,
            half: 0.5 * largest,
            layers,
            order,
            members: Vec::new(),
            covered: Vec::new(),
            fresh: Vec::new(),
            first: Vec::new(),
            travelled: 0.0,
            moved: 0.0,
        };
        own.begin();
        Ok(own)
    }

    /// Number of active nodes.
    pub fn len(&self) -> usize {
        self.first.last().copied().unwrap_or(0)
    }

    /// Whether the zero set has vanished.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Number of nodes in all layers.
    pub fn num_covered(&self) -> usize {
        self.covered.iter().map(count).sum()
    }

    /// The field.
    pub fn blocks(&self) -> &Blocks<D> {
        &self.blocks
    }

    /// Layers on each side.
    pub fn layers(&self) -> usize {
        self.layers
    }

    /// Masks a slot.
    fn kinds(&self) -> usize {
        2 * self.layers + 1
    }

    /// Which of a slot's masks layer `k` is, `outside` or not.
    fn kind(k: usize, outside: bool) -> usize {
        if k == 0 {
            0
        } else {
            2 * k - usize::from(outside)
        }
    }

    fn active(&self, slot: usize) -> &Mask {
        &self.members[slot * self.kinds()]
    }

    /// Number the active nodes.
    fn number(&mut self) {
        let kinds = self.kinds();
        self.first.clear();
        let mut total = 0;
        self.first.push(0);
        for slot in 0..self.blocks.len() {
            total += count(&self.members[slot * kinds]);
            self.first.push(total);
        }
    }

    /// Buffers for the blocks that there are.
    fn fit(&mut self) {
        let (slots, kinds) = (self.blocks.len(), self.kinds());
        self.members.resize(slots * kinds, EMPTY);
        self.covered.resize(slots, EMPTY);
        self.work.resize(self.blocks.values().len(), 0.0);
        self.scratch.resize(self.blocks.values().len(), 0.0);
    }
}

#[cfg(test)]
mod tests;
