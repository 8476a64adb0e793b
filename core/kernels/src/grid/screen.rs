//! Which blocks the zero set cannot come near, from the range and the differences of their node values alone.
//!
//! A B-spline coefficient is its node value less a sixth of the second difference along each axis in turn. With first
//! differences of at most g, one axis puts it off by g / 3 and makes the differences along the others 5/3 as large: by
//! 49/27 g in all in space, by 8/9 g in the plane. Beyond the border values go on linearly; there an axis costs g and a
//! factor of 3.

use multiversion::multiversion;
use rayon::prelude::*;

use super::blocks::{Blocks, Neighbor, SIDE};

/// Range and largest first difference of a block's values, those to the blocks beside it included.
#[derive(Debug, Clone, Copy)]
struct Extent {
    low: f64,
    high: f64,
    step: f64,
}

impl Extent {
    fn join(self, other: Self) -> Self {
        Self {
            low: self.low.min(other.low),
            high: self.high.max(other.high),
            step: self.step.max(other.step),
        }
    }
}

/// Extents of all stored blocks.
pub struct Screen<'a, const D: usize> {
    blocks: &'a Blocks<D>,
    extents: Vec<Extent>,
}

impl<'a, const D: usize> Screen<'a, D> {
    pub fn new(blocks: &'a Blocks<D>) -> Self {
        let extents = (0..blocks.len())
            .into_par_iter()
            .map(|slot| extent(blocks, slot))
            .collect();
        Self { blocks, extents }
    }

    /// The blocks, of those given by their places, in whose cells a coefficient may not lie beyond `margin` on one side, each
    /// with what node values around it must exceed for that: infinite on the border of the grid.
    pub fn crossed(&self, places: &[[i64; D]], margin: f64) -> Vec<([i64; D], f64)> {
        places
            .par_iter()
            .filter_map(|&place| Some((place, self.reach(&place, margin)?)))
            .collect()
    }

    fn reach(&self, place: &[i64; D], margin: f64) -> Option<f64> {
        let counts = self.blocks.counts();
        let border = (0..D).any(|a| place[a] == 0 || place[a] + 1 == counts[a] as i64);
        let mut all = self.at(*place);
        for k in 0..3_usize.pow(D as u32) {
            let mut rest = k;
            let near = std::array::from_fn(|a| {
                let step = (rest % 3) as i64 - 1;
                rest /= 3;
                place[a] + step
            });
            if self.blocks.block(near) != Neighbor::Border {
                all = all.join(self.at(near));
            }
        }
        let share = match (border, D) {
            (false, 2) => 8.0 / 9.0,
            (false, _) => 49.0 / 27.0,
            (true, 2) => 4.0,
            (true, _) => 13.0,
        };
        let reach = margin + share * all.step;
        // The border closes what is inside of it.
        if all.low > reach || (all.high < -reach && !border) {
            return None;
        }
        Some(if border { f64::INFINITY } else { reach })
    }

    /// Of uniform blocks too; differences to others are those of the blocks beside them.
    fn at(&self, place: [i64; D]) -> Extent {
        let value = match self.blocks.block(place) {
            Neighbor::Slot(slot) => return self.extents[slot as usize],
            Neighbor::Inside => -self.blocks.far(),
            _ => self.blocks.far(),
        };
        Extent {
            low: value,
            high: value,
            step: 0.0,
        }
    }
}

/// Running extremes, entry by entry of a row, so that rows are worked on several entries at once.
struct Lanes {
    low: [f64; SIDE],
    high: [f64; SIDE],
    step: [f64; SIDE],
}

impl Lanes {
    #[inline(always)]
    fn value(&mut self, row: &[f64; SIDE]) {
        for k in 0..SIDE {
            // Comparisons compile to one instruction, where `min` has to look for NaN.
            self.low[k] = if row[k] < self.low[k] { row[k] } else { self.low[k] };
            self.high[k] = if row[k] > self.high[k] {
                row[k]
            } else {
                self.high[k]
            };
        }
    }

    #[inline(always)]
    fn step(&mut self, row: &[f64; SIDE], other: &[f64; SIDE]) {
        for k in 0..SIDE {
            let d = (row[k] - other[k]).abs();
            self.step[k] = if d > self.step[k] { d } else { self.step[k] };
        }
    }
}

#[inline(always)]
fn row(values: &[f64], number: usize) -> [f64; SIDE] {
    std::array::from_fn(|k| values[number * SIDE + k])
}

#[multiversion(targets("x86_64+avx+avx2"))]
fn extent<const D: usize>(blocks: &Blocks<D>, slot: usize) -> Extent {
    let volume = Blocks::<D>::VOLUME;
    let of = |slot: usize| &blocks.values()[slot * volume..(slot + 1) * volume];
    let own = of(slot);
    let rows = volume / SIDE;
    let mut lanes = Lanes {
        low: [f64::INFINITY; SIDE],
        high: [f64::NEG_INFINITY; SIDE],
        step: [0.0; SIDE],
    };
    // What lies below and above along each axis: a block, or one value; nothing beyond the border.
    let beside: [[Option<(&[f64], f64)>; 2]; D] = std::array::from_fn(|axis| {
        [false, true].map(|up| match blocks.neighbor(slot, axis, up) {
            Neighbor::Border => None,
            Neighbor::Slot(other) => Some((of(other as usize), 0.0)),
            Neighbor::Outside => Some((&[][..], blocks.far())),
            Neighbor::Inside => Some((&[][..], -blocks.far())),
        })
    });
    for number in 0..rows {
        let here = row(own, number);
        lanes.value(&here);
        // Along the rows: each entry and the next one, the last one and the next block's first.
        let mut next = here;
        next[..SIDE - 1].copy_from_slice(&here[1..]);
        if let Some((values, value)) = beside[D - 1][1] {
            next[SIDE - 1] = values.get(number * SIDE).copied().unwrap_or(value);
        }
        lanes.step(&here, &next);
        if let Some((values, value)) = beside[D - 1][0] {
            next[0] = values.get(number * SIDE + SIDE - 1).copied().unwrap_or(value);
            next[1..].copy_from_slice(&here[1..]);
            lanes.step(&here, &next);
        }
        for axis in 0..D - 1 {
            let stride = SIDE.pow((D - 2 - axis) as u32);
            let place = number / stride % SIDE;
            let wrap = (SIDE - 1) * stride;
            let mut across = |up: usize, other: usize| {
                if let Some((values, value)) = beside[axis][up] {
                    let there = if values.is_empty() {
                        [value; SIDE]
                    } else {
                        row(values, other)
                    };
                    lanes.step(&here, &there);
                }
            };
            if place == 0 {
                across(0, number + wrap);
            }
            if place == SIDE - 1 {
                across(1, number - wrap);
            } else {
                lanes.step(&here, &row(own, number + stride));
            }
        }
    }
    Extent {
        low: lanes.low.into_iter().fold(f64::INFINITY, f64::min),
        high: lanes.high.into_iter().fold(f64::NEG_INFINITY, f64::max),
        step: lanes.step.into_iter().fold(0.0, f64::max),
    }
}
