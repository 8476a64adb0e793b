//! Node values of a grid in blocks of eight nodes an axis; where all values of a block lie far off, only their sign is
//! kept.
//!
//! Axes are in C order: the last one is contiguous, within a block and over the table of blocks. Nodes of a block that
//! lie beyond the grid repeat the nearest node of the grid, so that stencils need no test for the border.

mod frame;

use rayon::prelude::*;

use crate::error::{KernelError, Result};
use frame::Frame;

/// Nodes of a block an axis, and its logarithm.
pub const SIDE: usize = 8;
const LOG: usize = 3;

/// Blocks at most: their numbers stand in 32 bits, and the table of a grid of 4096^3 nodes fits.
const MOST_BLOCKS: usize = 1 << 28;

/// What lies on one side of a block.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Neighbor {
    /// A block with values of its own.
    Slot(u32),
    /// All values are far and positive, or far and negative.
    Outside,
    Inside,
    /// The grid ends.
    Border,
}

const OUTSIDE: i32 = -1;
const INSIDE: i32 = -2;
const BORDER: i32 = -3;

/// Values on the nodes of a grid with `shape` nodes an axis.
#[derive(Debug, Clone)]
pub struct Blocks<const D: usize> {
    shape: [usize; D],
    counts: [usize; D],
    /// Slot of each block, or the sign of its values.
    table: Vec<i32>,
    /// Place of each slot's block, in blocks.
    places: Vec<[u32; D]>,
    /// `SIDE^D` values a slot.
    values: Vec<f64>,
    /// What lies below and above along each axis, one entry a slot and side.
    neighbors: Vec<i32>,
    /// |value| of blocks that are not stored.
    far: f64,
}

impl<const D: usize> Blocks<D> {
    /// Nodes of a block.
    pub const VOLUME: usize = SIDE.pow(D as u32);

    /// A grid whose values are all `far`: outside everywhere.
    pub fn new(shape: [usize; D], far: f64) -> Result<Self> {
        if shape.iter().any(|&n| n < 2) {
            return Err(KernelError::Invalid(format!(
                "shape: found {shape:?}, accepted are at least 2 nodes an axis"
            )));
        }
        if far.is_nan() || far <= 0.0 {
            return Err(KernelError::Invalid(format!(
                "far: found {far}, accepted is a positive length"
            )));
        }
        let counts = shape.map(|n| n.div_ceil(SIDE));
        let number = counts
            .iter()
            .try_fold(1_usize, |m, &c| m.checked_mul(c))
            .filter(|&m| m <= MOST_BLOCKS)
            .ok_or_else(|| {
                KernelError::TooLarge(format!("shape: found {shape:?}, more than {MOST_BLOCKS} blocks"))
            })?;
        Ok(Self {
            shape,
            counts,
            table: vec![OUTSIDE; number],
            places: Vec::new(),
            values: Vec::new(),
            neighbors: Vec::new(),
            far,
        })
    }

    /// The blocks of a dense array in C order that hold a value below `far` in magnitude or both signs; all of them when
    /// `far` is infinite.
    pub fn from_dense(shape: [usize; D], dense: &[f64], far: f64) -> Result<Self> {
        let mut own = Self::new(shape, far)?;
        let expected: usize = shape.iter().product();
        if dense.len() != expected {
            return Err(KernelError::Invalid(format!(
                "values: found {}, accepted are {expected} for shape {shape:?}",
                dense.len()
            )));
        }
        let strides = strides(&shape);
        let number = own.table.len();
        let signs: Vec<i32> = (0..number)
            .into_par_iter()
            .map(|b| {
                let place = own.place_of(b);
                let mut sign = None;
                let mut near = far == f64::INFINITY;
                own.rows(&place, |_, at, length| {
                    let from: usize = (0..D).map(|a| at[a] * strides[a]).sum();
                    for &v in &dense[from..from + length] {
                        let s = v < 0.0;
                        near |= v.abs() < far || v.is_nan() || *sign.get_or_insert(s) != s;
                    }
                });
                match (near, sign) {
                    (true, _) => 0,
                    (false, Some(true)) => INSIDE,
                    _ => OUTSIDE,
                }
            })
            .collect();
        own.table.copy_from_slice(&signs);
        let stored: Vec<usize> = (0..number).filter(|&b| signs[b] == 0).collect();
        own.places = stored.iter().map(|&b| own.place_of(b)).collect();
        own.values = vec![0.0; stored.len() * Self::VOLUME];
        for (slot, &b) in stored.iter().enumerate() {
            own.table[b] = slot as i32;
        }
        let (frame, mut values) = (own.frame(), std::mem::take(&mut own.values));
        values
            .par_chunks_mut(Self::VOLUME)
            .zip(&own.places)
            .for_each(|(chunk, place)| {
                frame.rows(place, |offset, at, length| {
                    let from: usize = (0..D).map(|a| at[a] * strides[a]).sum();
                    for (v, &d) in chunk[offset..offset + length].iter_mut().zip(&dense[from..]) {
                        *v = d.clamp(-far, far);
                    }
                });
                frame.pad(place, chunk);
            });
        own.values = values;
        own.link();
        Ok(own)
    }

    /// Blocks given by their places (in blocks, each once) and values, the signs of all others by the table in C order
    /// (true: inside).
    pub fn from_parts(
        shape: [usize; D],
        far: f64,
        places: &[[u32; D]],
        values: &[f64],
        inside: &[bool],
    ) -> Result<Self> {
        let mut own = Self::new(shape, far)?;
        let invalid = |text: String| Err(KernelError::Invalid(text));
        if inside.len() != own.table.len() {
            return invalid(format!(
                "inside: found {} blocks, accepted are {}",
                inside.len(),
                own.table.len()
            ));
        }
        if values.len() != places.len() * Self::VOLUME {
            return invalid(format!(
                "values: found {}, accepted are {} for {} blocks",
                values.len(),
                places.len() * Self::VOLUME,
                places.len()
            ));
        }
        if values.iter().any(|v| v.is_nan()) {
            return invalid("values: found NaN, accepted are numbers".into());
        }
        for (entry, &inside) in own.table.iter_mut().zip(inside) {
            *entry = if inside { INSIDE } else { OUTSIDE };
        }
        for (slot, place) in places.iter().enumerate() {
            if (0..D).any(|a| place[a] as usize >= own.counts[a]) {
                return invalid(format!(
                    "places: found {place:?}, accepted are blocks below {:?}",
                    own.counts
                ));
            }
            let b = own.number_of(place);
            if own.table[b] >= 0 {
                return invalid(format!("places: found {place:?} twice"));
            }
            own.table[b] = slot as i32;
        }
        own.places = places.to_vec();
        own.values = values.to_vec();
        own.link();
        own.pad();
        Ok(own)
    }

    /// The same field in a band of `far`: values beyond it are cut off, and so is what lies beyond `known`, where the values
    /// say nothing but the sign. Blocks that are all beyond, on one side, are not stored.
    pub fn narrowed(&self, known: f64, far: f64) -> Result<Self> {
        let mut own = Self::new(self.shape, far)?;
        let cut = |v: f64| {
            if v.abs() < known {
                v.clamp(-far, far)
            } else {
                far.copysign(v)
            }
        };
        let near = |values: &[f64]| {
            let inside = values[0] < 0.0;
            values.iter().any(|&v| cut(v).abs() < far || (v < 0.0) != inside)
        };
        let kept: Vec<bool> = self.values.par_chunks(Self::VOLUME).map(near).collect();
        let mut slots: Vec<usize> = (0..self.len()).filter(|&s| kept[s]).collect();
        slots.sort_unstable_by_key(|&s| self.places[s]);
        for (entry, &old) in own.table.iter_mut().zip(&self.table) {
            *entry = match old {
                slot if slot >= 0 && self.values[slot as usize * Self::VOLUME] < 0.0 => INSIDE,
                slot if slot >= 0 => OUTSIDE,
                sign => sign,
            };
        }
        own.places = slots.iter().map(|&s| self.places[s]).collect();
        for (slot, place) in own.places.iter().enumerate() {
            let b = own.number_of(place);
            own.table[b] = slot as i32;
        }
        own.values = vec![0.0; slots.len() * Self::VOLUME];
        own.values
            .par_chunks_mut(Self::VOLUME)
            .zip(&slots)
            .for_each(|(to, &from)| {
                let from = &self.values[from * Self::VOLUME..(from + 1) * Self::VOLUME];
                for (v, &old) in to.iter_mut().zip(from) {
                    *v = cut(old);
                }
            });
        own.link();
        Ok(own)
    }

    /// All values, C order.
    pub fn to_dense(&self) -> Vec<f64> {
        let mut dense = vec![0.0; self.shape.iter().product()];
        let strides = strides(&self.shape);
        // A slab of blocks is one run of the array.
        let slab = strides[0] * SIDE;
        let a_slab: usize = self.counts[1..].iter().product();
        dense.par_chunks_mut(slab).enumerate().for_each(|(k, out)| {
            for b in k * a_slab..(k + 1) * a_slab {
                let place = self.place_of(b);
                let entry = self.table[b];
                self.frame().rows(&place, |offset, at, length| {
                    let from = (0..D).map(|a| at[a] * strides[a]).sum::<usize>() - k * slab;
                    let row = &mut out[from..from + length];
                    if entry >= 0 {
                        let start = entry as usize * Self::VOLUME + offset;
                        row.copy_from_slice(&self.values[start..start + length]);
                    } else {
                        row.fill(if entry == INSIDE { -self.far } else { self.far });
                    }
                });
            }
        });
        dense
    }

    /// Nodes an axis.
    pub fn shape(&self) -> [usize; D] {
        self.shape
    }

    /// Blocks an axis.
    pub fn counts(&self) -> [usize; D] {
        self.counts
    }

    /// |value| of what is not stored.
    pub fn far(&self) -> f64 {
        self.far
    }

    /// Number of stored blocks.
    pub fn len(&self) -> usize {
        self.places.len()
    }

    /// Whether no block is stored.
    pub fn is_empty(&self) -> bool {
        self.places.is_empty()
    }

    /// Place of each stored block, in blocks.
    pub fn places(&self) -> &[[u32; D]] {
        &self.places
    }

    /// Values of all stored blocks, `SIDE^D` each.
    pub fn values(&self) -> &[f64] {
        &self.values
    }

    /// The same, to be changed; `pad` must follow where blocks reach beyond the grid.
    pub fn values_mut(&mut self) -> &mut [f64] {
        &mut self.values
    }

    /// Sign of the blocks that are not stored, C order: true is inside. Stored blocks count as outside.
    pub fn inside(&self) -> Vec<bool> {
        self.table.iter().map(|&entry| entry == INSIDE).collect()
    }

    /// Change the sign of a block that is not stored.
    pub fn set_inside(&mut self, place: &[u32; D], inside: bool) {
        let b = self.number_of(place);
        if self.table[b] < 0 {
            self.table[b] = if inside { INSIDE } else { OUTSIDE };
        }
    }

    /// The block at a place, which may lie beyond the grid.
    #[inline]
    pub fn block(&self, place: [i64; D]) -> Neighbor {
        if (0..D).any(|a| place[a] < 0 || place[a] as usize >= self.counts[a]) {
            return Neighbor::Border;
        }
        let b = place
            .iter()
            .zip(&self.counts)
            .fold(0, |b, (&p, &n)| b * n + p as usize);
        decode(self.table[b])
    }

    /// What lies below (`up` false) or above a stored block along an axis.
    #[inline(always)]
    pub fn neighbor(&self, slot: usize, axis: usize, up: bool) -> Neighbor {
        decode(self.neighbors[slot * 2 * D + 2 * axis + usize::from(up)])
    }

    /// Value at a node; beyond the grid that of the nearest node.
    #[inline]
    pub fn at(&self, node: [i64; D]) -> f64 {
        let node: [usize; D] = std::array::from_fn(|a| node[a].clamp(0, self.shape[a] as i64 - 1) as usize);
        let b = node
            .iter()
            .zip(&self.counts)
            .fold(0, |b, (&p, &n)| b * n + (p >> LOG));
        match self.table[b] {
            OUTSIDE => self.far,
            INSIDE => -self.far,
            slot => {
                let offset = node.iter().fold(0, |o, &p| o << LOG | p & (SIDE - 1));
                self.values[slot as usize * Self::VOLUME + offset]
            }
        }
    }

    /// Value `step` nodes (less than `SIDE`) along an axis from a node of a stored block.
    #[inline(always)]
    pub fn beside(&self, values: &[f64], slot: usize, offset: usize, axis: usize, step: isize) -> f64 {
        let at = (offset >> shift::<D>(axis) & (SIDE - 1)) as isize + step;
        let stride = 1_isize << shift::<D>(axis);
        let base = slot * Self::VOLUME;
        if (at as usize) < SIDE {
            return values[base + (offset as isize + step * stride) as usize];
        }
        let up = at > 0;
        let entry = self.neighbors[slot * 2 * D + 2 * axis + usize::from(up)];
        let wrap = if up { -(SIDE as isize) } else { SIDE as isize };
        match entry {
            OUTSIDE => self.far,
            INSIDE => -self.far,
            // The last node of the block: those beyond the grid repeat it.
            BORDER => {
                let last = if up { SIDE as isize - 1 } else { 0 };
                values[base + (offset as isize + (last - (at - step)) * stride) as usize]
            }
            slot => {
                values[slot as usize * Self::VOLUME + (offset as isize + (step + wrap) * stride) as usize]
            }
        }
    }

    /// Value one node along two axes at once from a node of a stored block.
    #[inline(always)]
    pub fn diagonal(
        &self,
        values: &[f64],
        slot: usize,
        offset: usize,
        axes: [usize; 2],
        steps: [isize; 2],
    ) -> f64 {
        let [a, b] = axes;
        let at = |axis: usize| (offset >> shift::<D>(axis) & (SIDE - 1)) as isize;
        let (p, q) = (at(a) + steps[0], at(b) + steps[1]);
        if (p as usize) < SIDE && (q as usize) < SIDE {
            let to = offset as isize + (steps[0] << shift::<D>(a)) + (steps[1] << shift::<D>(b));
            return values[slot * Self::VOLUME + to as usize];
        }
        // Across a side of the block: first along the axis that leaves it.
        let (first, second) = if (p as usize) < SIDE { (1, 0) } else { (0, 1) };
        let up = steps[first] > 0;
        let wrap = if up { 1 - SIDE as isize } else { SIDE as isize - 1 };
        match self.neighbors[slot * 2 * D + 2 * axes[first] + usize::from(up)] {
            OUTSIDE => self.far,
            INSIDE => -self.far,
            BORDER => self.beside(values, slot, offset, axes[second], steps[second]),
            other => {
                let there = (offset as isize + (wrap << shift::<D>(axes[first]))) as usize;
                self.beside(values, other as usize, there, axes[second], steps[second])
            }
        }
    }

    /// Store the blocks at `places` (those that are not stored yet), with the sign that they had.
    pub fn store(&mut self, places: &[[u32; D]]) {
        let first = self.len();
        for place in places {
            let b = self.number_of(place);
            let entry = self.table[b];
            if entry >= 0 {
                continue;
            }
            let value = if entry == INSIDE { -self.far } else { self.far };
            self.table[b] = self.places.len() as i32;
            self.places.push(*place);
            self.values.resize(self.values.len() + Self::VOLUME, value);
        }
        self.link_from(first);
    }

    /// Keep the blocks whose flag is set, in C order of their places; the others become uniform, with the sign of their
    /// first node. Returns the old slot of each new one.
    pub fn keep(&mut self, kept: &[bool]) -> Vec<u32> {
        for (slot, place) in self.places.iter().enumerate() {
            if !kept[slot] {
                let b = self.number_of(place);
                let inside = self.values[slot * Self::VOLUME] < 0.0;
                self.table[b] = if inside { INSIDE } else { OUTSIDE };
            }
        }
        let mut order: Vec<u32> = (0..self.len() as u32).filter(|&s| kept[s as usize]).collect();
        order.sort_by_key(|&s| self.places[s as usize]);
        self.places = order.iter().map(|&s| self.places[s as usize]).collect();
        self.values = permuted(&self.values, &order, Self::VOLUME);
        for (slot, place) in self.places.iter().enumerate() {
            let b = self.number_of(place);
            self.table[b] = slot as i32;
        }
        self.link();
        order
    }

    /// Give the nodes beyond the grid the value of the nearest node; whether there are any.
    pub fn pad(&mut self) -> bool {
        if self.shape.iter().all(|n| n % SIDE == 0) {
            return false;
        }
        let frame = self.frame();
        self.values
            .par_chunks_mut(Self::VOLUME)
            .zip(&self.places)
            .for_each(|(chunk, place)| frame.pad(place, chunk));
        true
    }

    /// Whether a node of a block lies on the grid.
    #[inline]
    pub fn on_grid(&self, place: &[u32; D], offset: usize) -> bool {
        (0..D).all(|a| (place[a] as usize) * SIDE + (offset >> shift::<D>(a) & (SIDE - 1)) < self.shape[a])
    }

    /// Node of an offset in a block.
    #[inline(always)]
    pub fn node(place: &[u32; D], offset: usize) -> [usize; D] {
        std::array::from_fn(|a| place[a] as usize * SIDE + (offset >> shift::<D>(a) & (SIDE - 1)))
    }

    fn number_of(&self, place: &[u32; D]) -> usize {
        place
            .iter()
            .zip(&self.counts)
            .fold(0, |b, (&p, &n)| b * n + p as usize)
    }

    fn place_of(&self, mut b: usize) -> [u32; D] {
        let mut place = [0; D];
        for a in (0..D).rev() {
            place[a] = (b % self.counts[a]) as u32;
            b /= self.counts[a];
        }
        place
    }

    fn link(&mut self) {
        self.neighbors.clear();
        self.link_from(0);
    }

    /// Neighbours of the slots from `first` on, and of those beside them.
    fn link_from(&mut self, first: usize) {
        self.neighbors.resize(self.len() * 2 * D, BORDER);
        for slot in first..self.len() {
            for side in 0..2 * D {
                let (axis, up) = (side / 2, side % 2);
                let mut place = self.places[slot].map(i64::from);
                place[axis] += if up == 1 { 1 } else { -1 };
                let entry = if place[axis] < 0 || place[axis] as usize >= self.counts[axis] {
                    BORDER
                } else {
                    self.table[self.number_of(&place.map(|p| p as u32))]
                };
                self.neighbors[slot * 2 * D + side] = entry;
                if entry >= 0 {
                    self.neighbors[entry as usize * 2 * D + (side ^ 1)] = slot as i32;
                }
            }
        }
    }

    fn frame(&self) -> Frame<D> {
        Frame { shape: self.shape }
    }

    fn rows(&self, place: &[u32; D], visit: impl FnMut(usize, [usize; D], usize)) {
        self.frame().rows(place, visit);
    }
}

/// Shift of an axis' coordinate within an offset.
#[inline(always)]
pub const fn shift<const D: usize>(axis: usize) -> usize {
    LOG * (D - 1 - axis)
}

/// Chunks of `length` values in a new order.
pub fn permuted<T: Copy>(values: &[T], order: &[u32], length: usize) -> Vec<T> {
    let mut out = Vec::with_capacity(order.len() * length);
    for &k in order {
        out.extend_from_slice(&values[k as usize * length..(k as usize + 1) * length]);
    }
    out
}

fn strides<const D: usize>(shape: &[usize; D]) -> [usize; D] {
    std::array::from_fn(|a| shape[a + 1..].iter().product())
}

#[inline(always)]
fn decode(entry: i32) -> Neighbor {
    match entry {
        OUTSIDE => Neighbor::Outside,
        INSIDE => Neighbor::Inside,
        BORDER => Neighbor::Border,
        slot => Neighbor::Slot(slot as u32),
    }
}

#[cfg(test)]
mod tests;
