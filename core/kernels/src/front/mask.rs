//! Sets of nodes as bits, one word for 64 nodes of a block; growing a set by its neighbours costs a few shifts.

use crate::grid::{Blocks, Neighbor};

/// Words of a block's mask; a planar block needs the first one only.
pub const WORDS: usize = 8;

/// One bit a node of a block, in the order of its values.
pub type Mask = [u64; WORDS];

pub const EMPTY: Mask = [0; WORDS];

/// Nodes with the lowest and the highest coordinate along the last axis.
const LOW: u64 = 0x0101_0101_0101_0101;
const HIGH: u64 = 0x8080_8080_8080_8080;

/// Number of words that hold bits.
pub const fn words(dim: usize) -> usize {
    if dim == 2 {
        1
    } else {
        WORDS
    }
}

/// Offsets of the bits, ascending.
#[inline(always)]
pub fn offsets(mask: &Mask) -> impl Iterator<Item = usize> + '_ {
    mask.iter().enumerate().flat_map(|(w, &word)| {
        let mut left = word;
        std::iter::from_fn(move || {
            (left != 0).then(|| {
                let k = left.trailing_zeros() as usize;
                left &= left - 1;
                w * 64 + k
            })
        })
    })
}

#[inline(always)]
pub fn has(mask: &Mask, offset: usize) -> bool {
    mask[offset / 64] >> (offset % 64) & 1 == 1
}

#[inline(always)]
pub fn insert(mask: &mut Mask, offset: usize) {
    mask[offset / 64] |= 1 << (offset % 64);
}

#[inline]
pub fn count(mask: &Mask) -> usize {
    mask.iter().map(|w| w.count_ones() as usize).sum()
}

#[inline]
pub fn is_empty(mask: &Mask) -> bool {
    mask.iter().all(|&w| w == 0)
}

#[inline]
pub fn union(a: &Mask, b: &Mask) -> Mask {
    std::array::from_fn(|w| a[w] | b[w])
}

#[inline]
pub fn both(a: &Mask, b: &Mask) -> Mask {
    std::array::from_fn(|w| a[w] & b[w])
}

/// Bits of `a` that are not in `b`.
#[inline]
pub fn without(a: &Mask, b: &Mask) -> Mask {
    std::array::from_fn(|w| a[w] & !b[w])
}

/// Bits of a block's set on its lower or upper face along an axis.
#[inline]
pub fn touches<const D: usize>(mask: &Mask, axis: usize, up: bool) -> bool {
    match D - 1 - axis {
        0 => {
            let face = if up { HIGH } else { LOW };
            mask.iter().any(|w| w & face != 0)
        }
        1 => {
            let face = if up { 0xff << 56 } else { 0xff };
            mask.iter().any(|w| w & face != 0)
        }
        _ => mask[if up { WORDS - 1 } else { 0 }] != 0,
    }
}

/// The nodes of a block whose neighbour below (`up` false) or above along an axis is in the set.
#[inline]
pub fn beside<const D: usize>(
    blocks: &Blocks<D>,
    masks: &[Mask],
    slot: usize,
    axis: usize,
    up: bool,
) -> Mask {
    let own = &masks[slot];
    let next = match blocks.neighbor(slot, axis, up) {
        Neighbor::Slot(s) => &masks[s as usize],
        _ => &EMPTY,
    };
    let mut out = EMPTY;
    match (D - 1 - axis, up) {
        (0, false) => (0..words(D)).for_each(|w| out[w] = (own[w] & !HIGH) << 1 | (next[w] & HIGH) >> 7),
        (0, true) => (0..words(D)).for_each(|w| out[w] = (own[w] & !LOW) >> 1 | (next[w] & LOW) << 7),
        (1, false) => (0..words(D)).for_each(|w| out[w] = own[w] << 8 | next[w] >> 56),
        (1, true) => (0..words(D)).for_each(|w| out[w] = own[w] >> 8 | next[w] << 56),
        (_, false) => {
            out[1..].copy_from_slice(&own[..WORDS - 1]);
            out[0] = next[WORDS - 1];
        }
        (_, true) => {
            out[..WORDS - 1].copy_from_slice(&own[1..]);
            out[WORDS - 1] = next[0];
        }
    }
    out
}

/// For each axis the nodes whose lower, and whose upper neighbour is in the set.
#[inline]
pub fn all_beside<const D: usize>(blocks: &Blocks<D>, masks: &[Mask], slot: usize) -> [[Mask; 2]; D] {
    std::array::from_fn(|a| [false, true].map(|up| beside(blocks, masks, slot, a, up)))
}

/// A block's set with all nodes beside it, those of the blocks around it included.
#[inline]
pub fn grown<const D: usize>(blocks: &Blocks<D>, masks: &[Mask], slot: usize) -> Mask {
    all_beside(blocks, masks, slot)
        .iter()
        .flatten()
        .fold(masks[slot], |m, other| union(&m, other))
}

/// The nodes of a block that lie on the grid.
pub fn valid<const D: usize>(blocks: &Blocks<D>, place: &[u32; D]) -> Mask {
    let mut mask = EMPTY;
    for offset in (0..Blocks::<D>::VOLUME).filter(|&o| blocks.on_grid(place, o)) {
        insert(&mut mask, offset);
    }
    mask
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Growing by shifts against growing by definition, across blocks.
    #[test]
    fn a_grown_set_is_the_set_with_its_neighbours() {
        let shape = [20, 16, 24];
        let blocks = Blocks::<3>::from_dense(shape, &vec![0.0; 20 * 16 * 24], f64::INFINITY).unwrap();
        let chosen = |node: [i64; 3]| (node[0] * 31 + node[1] * 17 + node[2] * 7) % 23 == 0;
        let masks: Vec<Mask> = blocks
            .places()
            .iter()
            .map(|place| {
                let mut mask = EMPTY;
                for o in 0..512 {
                    if chosen(Blocks::<3>::node(place, o).map(|x| x as i64)) {
                        insert(&mut mask, o);
                    }
                }
                mask
            })
            .collect();
        for (slot, place) in blocks.places().iter().enumerate() {
            let grown = grown(&blocks, &masks, slot);
            for o in 0..512 {
                let node = Blocks::<3>::node(place, o).map(|x| x as i64);
                let mut expected = chosen(node);
                for axis in 0..3 {
                    for step in [-1, 1] {
                        let mut at = node;
                        at[axis] += step;
                        let within = at[axis] >= 0 && at[axis] < blocks.counts()[axis] as i64 * 8;
                        expected |= within && chosen(at);
                    }
                }
                assert_eq!(has(&grown, o), expected, "{node:?}");
            }
        }
    }
}
