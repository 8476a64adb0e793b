//! What must hold of the layers between steps, written out slowly: for tests, and for those who doubt.

use super::mask::has;
use super::{Front, Order};
use crate::error::{KernelError, Result};
use crate::grid::{Blocks, Neighbor};

impl<const D: usize> Front<D> {
    /// Check all invariants; the error names the first node that breaks one.
    ///
    /// 1. A node is in one layer at most, and in one if it is in the band.
    /// 2. Active nodes have |f| <= h / 2.
    /// 3. Between neighbours of opposite sign one at least is active: the zero set is closed.
    /// 4. A node of layer k has a neighbour in layer k - 1 and none in a layer below; the next one outward is in the
    ///    band unless k is the last layer.
    /// 5. Values have their layer's sign; first-order ones lie half a spacing at most beyond k spacings
    ///    (of the smallest below, of the largest above).
    /// 6. What is in no layer has the far value.
    pub fn check_invariants(&self) -> Result<()> {
        for slot in 0..self.blocks.len() {
            let place = self.blocks.places()[slot];
            for offset in (0..Blocks::<D>::VOLUME).filter(|&o| self.blocks.on_grid(&place, o)) {
                let broken = self.broken(slot, offset);
                if let Some(what) = broken {
                    let node = Blocks::<D>::node(&place, offset);
                    return Err(KernelError::NotSolved(format!("node {node:?}: {what}")));
                }
            }
        }
        Ok(())
    }

    fn broken(&self, slot: usize, offset: usize) -> Option<String> {
        let f = self.blocks.values()[slot * Blocks::<D>::VOLUME + offset];
        let (layer, copies) = self.layer_of(slot, offset);
        let far = self.blocks.far();
        if copies > 1 || has(&self.covered[slot], offset) != (copies == 1) {
            return Some(format!("in {copies} layers"));
        }
        let bound =
            |pick: fn(f64, f64) -> f64| self.spacing[1..].iter().fold(self.spacing[0], |m, &h| pick(m, h));
        let (least, most) = (bound(f64::min), bound(f64::max));
        let beyond = |k: i32| {
            let (k, slack) = (f64::from(k.abs()), self.half * (1.0 + 1e-9));
            f.abs() < k * least - slack || f.abs() > k * most + slack
        };
        match layer {
            None if (f.abs() - far).abs() > 1e-12 * far => return Some(format!("value {f} in no layer")),
            Some(0) if f.abs() > self.half => return Some(format!("active with value {f}")),
            Some(k) if k != 0 && (f < 0.0) != (k < 0) => return Some(format!("value {f} in layer {k}")),
            Some(k) if k != 0 && self.order == Order::First && beyond(k) => {
                return Some(format!("value {f} in layer {k}"));
            }
            _ => {}
        }
        let (mut nearest, last) = (i32::MAX, self.layers as i32);
        for axis in 0..D {
            for step in [-1_i64, 1] {
                let Some((s, o)) = self.next(slot, offset, axis, step) else {
                    continue;
                };
                let other = self
                    .blocks
                    .beside(self.blocks.values(), slot, offset, axis, step as isize);
                let beside = s.and_then(|s| self.layer_of(s, o).0);
                if (other < 0.0) != (f < 0.0) && layer != Some(0) && beside != Some(0) {
                    return Some(format!("values {f} and {other} with no active node between"));
                }
                nearest = nearest.min(beside.map_or(i32::MAX, i32::abs));
                if layer.is_some_and(|k| k.abs() < last) && beside.is_none() {
                    return Some("its neighbour is missing".into());
                }
            }
        }
        match layer {
            Some(k) if k != 0 && nearest != k.abs() - 1 => {
                Some(format!("in layer {k} beside layer {nearest}"))
            }
            _ => None,
        }
    }

    /// Signed layer of a node, and in how many it is.
    fn layer_of(&self, slot: usize, offset: usize) -> (Option<i32>, usize) {
        let (mut layer, mut copies) = (None, 0);
        for k in 0..=self.layers {
            for outside in [true, false] {
                if (k > 0 || outside)
                    && has(
                        &self.members[slot * self.kinds() + Self::kind(k, outside)],
                        offset,
                    )
                {
                    layer = Some(if outside { k as i32 } else { -(k as i32) });
                    copies += 1;
                }
            }
        }
        (layer, copies)
    }

    /// The neighbouring node on the grid: its block, if that is stored, and its offset there.
    fn next(&self, slot: usize, offset: usize, axis: usize, step: i64) -> Option<(Option<usize>, usize)> {
        let place = self.blocks.places()[slot];
        let mut node = Blocks::<D>::node(&place, offset).map(|x| x as i64);
        node[axis] += step;
        if node[axis] < 0 || node[axis] >= self.blocks.shape()[axis] as i64 {
            return None;
        }
        let there = node.iter().fold(0, |o, &x| o << 3 | (x & 7) as usize);
        match self.blocks.block(node.map(|x| x >> 3)) {
            Neighbor::Slot(s) => Some((Some(s as usize), there)),
            _ => Some((None, there)),
        }
    }
}
