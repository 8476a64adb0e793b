//! Where the nodes of a block lie on the grid.

use super::{shift, LOG, SIDE};

/// The grid's extent alone, for loops over values that are borrowed.
#[derive(Clone, Copy)]
pub(super) struct Frame<const D: usize> {
    pub(super) shape: [usize; D],
}

impl<const D: usize> Frame<D> {
    /// Nodes of a block on the grid, an axis.
    fn extent(&self, place: &[u32; D]) -> [usize; D] {
        std::array::from_fn(|a| (self.shape[a] - place[a] as usize * SIDE).min(SIDE))
    }

    /// Visit the contiguous rows of a block on the grid: offset in the block, first node, length.
    pub(super) fn rows(&self, place: &[u32; D], mut visit: impl FnMut(usize, [usize; D], usize)) {
        let extent = self.extent(place);
        let count: usize = extent[..D - 1].iter().product();
        for mut k in 0..count {
            let mut local = [0; D];
            for a in (0..D - 1).rev() {
                local[a] = k % extent[a];
                k /= extent[a];
            }
            let offset = local.iter().fold(0, |o, &p| o << LOG | p);
            visit(
                offset,
                std::array::from_fn(|a| place[a] as usize * SIDE + local[a]),
                extent[D - 1],
            );
        }
    }

    pub(super) fn pad(&self, place: &[u32; D], chunk: &mut [f64]) {
        let extent = self.extent(place);
        if extent.iter().all(|&n| n == SIDE) {
            return;
        }
        for offset in 0..SIDE.pow(D as u32) {
            let nearest = (0..D).fold(0, |o, a| {
                o << LOG | (offset >> shift::<D>(a) & (SIDE - 1)).min(extent[a] - 1)
            });
            if nearest != offset {
                chunk[offset] = chunk[nearest];
            }
        }
    }
}
