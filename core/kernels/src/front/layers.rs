//! Which node belongs to which layer, before the first step and after each.

use rayon::prelude::*;

use super::mask::{
    all_beside, both, grown, has, insert, is_empty, offsets, touches, union, valid, without, Mask, EMPTY,
};
use super::{Front, Order};
use crate::grid::{Blocks, Neighbor};

/// Share of the difference from |grad f| = 1 that the layers make up each time that the zero set has travelled `DRIFT`
/// spacings: what is carried along normals drifts from a distance as it moves, not as time goes by.
const RESTORED: f64 = 0.5;
const DRIFT: f64 = 1.0;

/// Rounds over nodes that are new in a layer: they depend on one another.
const SWEEPS: usize = 3;

impl<const D: usize> Front<D> {
    /// Layers of a field that is about a distance.
    pub(super) fn begin(&mut self) {
        self.fit();
        let everywhere: Vec<Mask> = self
            .blocks
            .places()
            .par_iter()
            .map(|place| valid(&self.blocks, place))
            .collect();
        self.work.copy_from_slice(self.blocks.values());
        let active = self.nearest(&everywhere);
        self.covered = self
            .work
            .chunks(Blocks::<D>::VOLUME)
            .zip(&everywhere)
            .map(|(values, on_grid)| {
                let mut given = EMPTY;
                for offset in offsets(on_grid).filter(|&o| values[o].abs() < self.blocks.far()) {
                    insert(&mut given, offset);
                }
                given
            })
            .collect();
        self.relabel(active);
        self.finish(false);
    }

    /// The end of a step: the values of the last stage become the field's, and the layers follow the zero set.
    pub fn commit(&mut self) {
        let active = match self.order {
            Order::First => self.handed_on(),
            Order::Second => {
                let kinds = self.kinds();
                let near: Vec<Mask> = self
                    .members
                    .chunks(kinds)
                    .map(|m| union(&m[0], &union(&m[1], &m[2])))
                    .collect();
                self.nearest(&near)
            }
        };
        self.relabel(active);
        self.travelled += std::mem::take(&mut self.moved);
        let restore = self.travelled >= DRIFT;
        if restore {
            self.travelled = 0.0;
        }
        self.finish(restore);
    }

    /// The candidates with |f| <= h / 2, and the nearer one of each two neighbours of opposite sign: without a node of
    /// the active layer between them the zero set would leak.
    fn nearest(&mut self, candidates: &[Mask]) -> Vec<Mask> {
        let half = self.half;
        let stencil = self.stencil(true);
        let found: Vec<(Mask, Mask)> = candidates
            .par_iter()
            .enumerate()
            .map(|(slot, candidates)| {
                let (mut active, mut cut) = (EMPTY, EMPTY);
                for offset in offsets(candidates) {
                    let f = stencil.values[slot * Blocks::<D>::VOLUME + offset];
                    if f.abs() <= half {
                        insert(&mut active, offset);
                        continue;
                    }
                    let crossed = (0..D).any(|a| {
                        [-1, 1].iter().any(|&step| {
                            let other = stencil.beside(slot, offset, a, step);
                            let opposite = (other < 0.0) != (f < 0.0);
                            // Of two equal ones that below.
                            let nearer = f.abs() < other.abs() || (f.abs() <= other.abs() && step > 0);
                            opposite && nearer && other.abs() > half
                        })
                    });
                    if crossed {
                        insert(&mut active, offset);
                        insert(&mut cut, offset);
                    }
                }
                (active, cut)
            })
            .collect();
        self.work
            .par_chunks_mut(Blocks::<D>::VOLUME)
            .zip(&found)
            .for_each(|(values, (_, cut))| {
                for offset in offsets(cut) {
                    values[offset] = half.copysign(values[offset]);
                }
            });
        found.into_iter().map(|(active, _)| active).collect()
    }

    /// Whitaker's rule: a node that leaves the active range hands its value, one spacing less, to its neighbours on the
    /// side that it comes from. Of two neighbours that leave in opposite directions both stay, with their old values.
    fn handed_on(&mut self) -> Vec<Mask> {
        let (half, kinds) = (self.half, self.kinds());
        let leaving = |slot: usize, sign: f64| {
            let mut mask = EMPTY;
            for offset in offsets(self.active(slot)) {
                if sign * self.work[slot * Blocks::<D>::VOLUME + offset] > half {
                    insert(&mut mask, offset);
                }
            }
            mask
        };
        let slots = self.blocks.len();
        let lists: [Vec<Mask>; 2] = [1.0, -1.0].map(|sign| {
            (0..slots)
                .into_par_iter()
                .map(|slot| leaving(slot, sign))
                .collect()
        });
        let stay: [Vec<Mask>; 2] = [0, 1].map(|k: usize| {
            (0..slots)
                .into_par_iter()
                .map(|slot| {
                    let near = grown(&self.blocks, &lists[1 - k], slot);
                    std::array::from_fn(|w| lists[k][slot][w] & near[w])
                })
                .collect()
        });
        let gone: [Vec<Mask>; 2] = [0, 1].map(|k: usize| {
            (0..slots)
                .map(|slot| without(&lists[k][slot], &stay[k][slot]))
                .collect()
        });
        let stencil = self.stencil(true);
        let members = &self.members;
        let entered: Vec<(Mask, Vec<(usize, f64)>)> = (0..slots)
            .into_par_iter()
            .map(|slot| {
                let (mut mask, mut values) = (EMPTY, Vec::new());
                // What leaves outward (k = 0) activates nodes of L-1, and the other way round.
                for (k, sign) in [(0, 1.0), (1, -1.0)] {
                    let candidates = &members[slot * kinds + Self::kind(1, k == 1)];
                    let from = all_beside(&self.blocks, &gone[k], slot);
                    for offset in offsets(candidates) {
                        let mut best: Option<f64> = None;
                        for a in 0..D {
                            for (side, step) in [(0, -1), (1, 1)] {
                                if has(&from[a][side], offset) {
                                    let value =
                                        stencil.beside(slot, offset, a, step) - sign * self.spacing[a];
                                    if best.is_none_or(|b| value.abs() < b.abs()) {
                                        best = Some(value);
                                    }
                                }
                            }
                        }
                        if let Some(value) = best {
                            insert(&mut mask, offset);
                            values.push((offset, value.clamp(-half, half)));
                        }
                    }
                }
                (mask, values)
            })
            .collect();
        let before = self.blocks.values();
        self.work
            .par_chunks_mut(Blocks::<D>::VOLUME)
            .enumerate()
            .for_each(|(slot, values)| {
                for offset in offsets(&union(&stay[0][slot], &stay[1][slot])) {
                    values[offset] = before[slot * Blocks::<D>::VOLUME + offset];
                }
                for &(offset, value) in &entered[slot].1 {
                    values[offset] = value;
                }
            });
        (0..slots)
            .map(|slot| {
                let left = union(&gone[0][slot], &gone[1][slot]);
                union(&without(self.active(slot), &left), &entered[slot].0)
            })
            .collect()
    }

    /// Layers around the active nodes, blocks for them, and values for the nodes that they lost. `work` holds the values.
    fn relabel(&mut self, active: Vec<Mask>) {
        let before = std::mem::replace(&mut self.covered, active);
        let kinds = self.kinds();
        self.members.fill(EMPTY);
        for (members, active) in self.members.chunks_mut(kinds).zip(&self.covered) {
            members[0] = *active;
        }
        for k in 1..=self.layers {
            self.open();
            let (blocks, covered, work) = (&self.blocks, &self.covered, &self.work);
            let full = blocks.shape().iter().all(|n| n % crate::grid::blocks::SIDE == 0);
            let grown: Vec<Mask> = self
                .members
                .par_chunks_mut(kinds)
                .enumerate()
                .map(|(slot, members)| {
                    let mut grown = grown(blocks, covered, slot);
                    if !full {
                        let valid = valid(blocks, &blocks.places()[slot]);
                        grown = std::array::from_fn(|w| grown[w] & valid[w]);
                    }
                    for offset in offsets(&without(&grown, &covered[slot])) {
                        let outside = work[slot * Blocks::<D>::VOLUME + offset] >= 0.0;
                        insert(&mut members[Self::kind(k, outside)], offset);
                    }
                    grown
                })
                .collect();
            self.covered = grown;
        }
        self.fresh = self
            .covered
            .iter()
            .enumerate()
            .map(|(slot, now)| before.get(slot).map_or(*now, |before| without(now, before)))
            .collect();
        self.forget(&before);
    }

    /// Store the blocks that the covered nodes are about to grow into.
    fn open(&mut self) {
        let mut places = Vec::new();
        for slot in 0..self.blocks.len() {
            if is_empty(&self.covered[slot]) {
                continue;
            }
            for axis in 0..D {
                for up in [false, true] {
                    let missing = matches!(
                        self.blocks.neighbor(slot, axis, up),
                        Neighbor::Outside | Neighbor::Inside
                    );
                    if missing && touches::<D>(&self.covered[slot], axis, up) {
                        let mut place = self.blocks.places()[slot];
                        place[axis] = place[axis].wrapping_add_signed(if up { 1 } else { -1 });
                        places.push(place);
                    }
                }
            }
        }
        if places.is_empty() {
            return;
        }
        places.sort_unstable();
        places.dedup();
        let first = self.blocks.len();
        self.blocks.store(&places);
        self.fit();
        let from = first * Blocks::<D>::VOLUME;
        self.work[from..].copy_from_slice(&self.blocks.values()[from..]);
    }

    /// Nodes that are in no layer any more keep their sign only, and so do blocks without covered nodes.
    fn forget(&mut self, before: &[Mask]) {
        let (far, covered) = (self.blocks.far(), &self.covered);
        self.work
            .par_chunks_mut(Blocks::<D>::VOLUME)
            .zip(before)
            .zip(covered)
            .for_each(|((values, before), covered)| {
                for offset in offsets(&without(before, covered)) {
                    values[offset] = far.copysign(values[offset]);
                }
            });
        let kept: Vec<bool> = self.covered.iter().map(|m| !is_empty(m)).collect();
        let empty = kept.iter().filter(|k| !**k).count();
        if 4 * empty > kept.len() {
            let kinds = self.kinds();
            self.blocks.values_mut().copy_from_slice(&self.work);
            let order = self.blocks.keep(&kept);
            self.covered = order.iter().map(|&s| self.covered[s as usize]).collect();
            self.fresh = order.iter().map(|&s| self.fresh[s as usize]).collect();
            self.members = order
                .iter()
                .flat_map(|&s| self.members[s as usize * kinds..(s as usize + 1) * kinds].to_vec())
                .collect();
            self.fit_exactly();
            self.work.copy_from_slice(self.blocks.values());
        }
    }

    fn fit_exactly(&mut self) {
        let length = self.blocks.values().len();
        self.work.truncate(length);
        self.scratch.truncate(length);
        self.fit();
    }

    /// Values of the layers, outward, and the field's.
    fn finish(&mut self, restore: bool) {
        match self.order {
            Order::First => self.city_blocks(),
            Order::Second => self.distances(restore),
        }
        copy(&self.work, self.blocks.values_mut());
        if self.blocks.pad() {
            copy(self.blocks.values(), &mut self.work);
        }
        self.number();
    }

    /// Whitaker's values, one spacing from layer to layer.
    fn city_blocks(&mut self) {
        let kinds = self.kinds();
        let far = self.blocks.far();
        let mut inner: Vec<Mask> = self.members.chunks(kinds).map(|m| m[0]).collect();
        for k in 1..=self.layers {
            let mut scratch = std::mem::take(&mut self.scratch);
            {
                let stencil = self.stencil(true);
                self.each(k, &mut scratch, |slot, members, out| {
                    let sides = all_beside(&self.blocks, &inner, slot);
                    for (members, sign) in members.into_iter().zip([1.0, -1.0]) {
                        for offset in offsets(members) {
                            if let Some(u) = stencil.city_block(slot, offset, &sides, sign > 0.0) {
                                out[offset] = sign * u.clamp(0.0, far);
                            }
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

    /// Distances: nodes that were in a layer before keep most of what was carried to them, new ones are computed.
    fn distances(&mut self, restore: bool) {
        let far = self.blocks.far();
        for k in 1..=self.layers {
            for sweep in 0..SWEEPS {
                let all = restore && sweep == 0;
                let mut scratch = std::mem::take(&mut self.scratch);
                {
                    let stencil = self.stencil(true);
                    self.each(k, &mut scratch, |slot, members, out| {
                        let values =
                            &stencil.values[slot * Blocks::<D>::VOLUME..(slot + 1) * Blocks::<D>::VOLUME];
                        let fresh = &self.fresh[slot];
                        for (members, sign) in members.into_iter().zip([1.0, -1.0]) {
                            let chosen = if all { *members } else { both(members, fresh) };
                            for offset in offsets(&chosen) {
                                let now = values[offset];
                                out[offset] = now;
                                if let Some(u) = stencil.eikonal(slot, offset, sign > 0.0) {
                                    let u = sign * u.clamp(0.0, far * (1.0 - 1e-9));
                                    let share = if has(fresh, offset) { 1.0 } else { RESTORED };
                                    out[offset] = now + share * (u - now);
                                }
                            }
                        }
                    });
                }
                self.scratch = scratch;
                self.spread(k, !all);
            }
        }
    }

    /// Visit the members of layer k block by block: those outside, and those inside.
    fn each(&self, k: usize, scratch: &mut [f64], visit: impl Fn(usize, [&Mask; 2], &mut [f64]) + Sync) {
        let kinds = self.kinds();
        scratch
            .par_chunks_mut(Blocks::<D>::VOLUME)
            .enumerate()
            .for_each(|(slot, out)| {
                let members =
                    [true, false].map(|outside| &self.members[slot * kinds + Self::kind(k, outside)]);
                if members.iter().any(|m| !is_empty(m)) {
                    visit(slot, members, out);
                }
            });
    }

    /// Take layer k's values over from `scratch`, those of new nodes only or all.
    pub(super) fn spread(&mut self, k: usize, only_fresh: bool) {
        let kinds = self.kinds();
        let (members, fresh) = (&self.members, &self.fresh);
        self.work
            .par_chunks_mut(Blocks::<D>::VOLUME)
            .zip(self.scratch.par_chunks(Blocks::<D>::VOLUME))
            .enumerate()
            .for_each(|(slot, (values, new))| {
                let own = &members[slot * kinds..(slot + 1) * kinds];
                let mut chosen = if k == 0 {
                    own[0]
                } else {
                    union(&own[Self::kind(k, true)], &own[Self::kind(k, false)])
                };
                if only_fresh {
                    chosen = both(&chosen, &fresh[slot]);
                }
                for offset in offsets(&chosen) {
                    values[offset] = new[offset];
                }
            });
    }
}

/// Copy a list on all threads.
pub(super) fn copy(from: &[f64], to: &mut [f64]) {
    const CHUNK: usize = 1 << 15;
    to.par_chunks_mut(CHUNK)
        .zip(from.par_chunks(CHUNK))
        .for_each(|(to, from)| to.copy_from_slice(from));
}
