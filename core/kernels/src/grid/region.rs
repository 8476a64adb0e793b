//! The nodes of stored blocks, numbered through: their places and neighbours.

use super::blocks::{Blocks, Neighbor, SIDE};

/// Nodes of the blocks that a kernel works on.
pub struct Region<'a, const D: usize> {
    pub blocks: &'a Blocks<D>,
    pub spacing: [f64; D],
    /// Shortest and longest spacing.
    pub finest: f64,
    pub widest: f64,
    /// Place of the last node; the first one is the origin.
    pub high: [f64; D],
    /// Nodes near the zero set, ascending, and the number in that list of each node.
    pub near: Vec<usize>,
    pub number: Vec<u32>,
}

impl<'a, const D: usize> Region<'a, D> {
    pub fn new(blocks: &'a Blocks<D>, spacing: &[f64; D]) -> Self {
        let shape = blocks.shape();
        Self {
            blocks,
            spacing: *spacing,
            finest: spacing.iter().fold(f64::INFINITY, |m, &h| m.min(h)),
            widest: spacing.iter().fold(0.0, |m, &h| m.max(h)),
            high: std::array::from_fn(|a| (shape[a] - 1) as f64 * spacing[a]),
            near: Vec::new(),
            number: Vec::new(),
        }
    }

    /// Number of nodes, those of blocks that lie beyond the grid included.
    pub fn len(&self) -> usize {
        self.blocks.values().len()
    }

    /// The node at a place of the grid, if its block is stored.
    pub fn find(&self, node: [usize; D]) -> Option<usize> {
        match self.blocks.block(node.map(|x| (x / SIDE) as i64)) {
            Neighbor::Slot(slot) => {
                Some(slot as usize * Blocks::<D>::VOLUME + node.iter().fold(0, |o, &x| o * SIDE + x % SIDE))
            }
            _ => None,
        }
    }

    /// Index coordinates.
    #[inline]
    pub fn node(&self, k: usize) -> [usize; D] {
        Blocks::<D>::node(
            &self.blocks.places()[k / Blocks::<D>::VOLUME],
            k % Blocks::<D>::VOLUME,
        )
    }

    /// Place of a node.
    #[inline]
    pub fn place(&self, k: usize) -> [f64; D] {
        let node = self.node(k);
        std::array::from_fn(|a| node[a] as f64 * self.spacing[a])
    }

    /// The next node along an axis, if it is on the grid and its block is stored.
    #[inline]
    pub fn beside(&self, k: usize, axis: usize, up: bool) -> Option<usize> {
        let (slot, offset) = (k / Blocks::<D>::VOLUME, k % Blocks::<D>::VOLUME);
        let stride = SIDE.pow((D - 1 - axis) as u32);
        let local = offset / stride % SIDE;
        if up {
            let at = self.blocks.places()[slot][axis] as usize * SIDE + local;
            if at + 1 >= self.blocks.shape()[axis] {
                return None;
            }
            if local + 1 < SIDE {
                return Some(k + stride);
            }
        } else if local > 0 {
            return Some(k - stride);
        }
        match self.blocks.neighbor(slot, axis, up) {
            Neighbor::Slot(other) => {
                let wrap = (SIDE - 1) * stride;
                let offset = if up { offset - wrap } else { offset + wrap };
                Some(other as usize * Blocks::<D>::VOLUME + offset)
            }
            _ => None,
        }
    }

    /// Visit the nodes beside a node.
    #[inline]
    pub fn each_beside(&self, k: usize, mut visit: impl FnMut(usize)) {
        for axis in 0..D {
            for up in [false, true] {
                if let Some(other) = self.beside(k, axis, up) {
                    visit(other);
                }
            }
        }
    }
}
