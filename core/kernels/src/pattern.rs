//! The sparsity pattern of the normal equations: it depends on the mesh alone and is made once.

use std::ops::Range;

use rayon::prelude::*;

use crate::element::Elements;
use crate::error::{KernelError, Result};

/// The most element-wise products that a pattern may hold, 4 bytes each.
const MAX_PRODUCTS: usize = 400_000_000;
/// Elements are assembled in this many groups at most, and in groups of this many elements at least. Neither depends on
/// the number of threads, so that sums do not either.
const GROUPS: usize = 64;
const GROUP: usize = 256;

/// Symmetric pattern with everything that a refill needs.
///
/// Elements are taken in groups. Each group adds its elements' products into rows of its own, `partial`, in which every
/// row of the lower triangle that it touches stands in full, its right-hand side behind it. A row of the matrix then is
/// the sum of its copies in the groups, in their order: the same bits for any number of threads.
#[derive(Debug, Clone)]
pub struct Pattern {
    pub row_start: Vec<usize>,
    pub columns: Vec<u32>,
    /// For every entry of the full matrix its place in the lower triangle.
    pub lower_of: Vec<u32>,
    pub lower_start: Vec<usize>,
    group: usize,
    /// Where each group's rows start in the array of all partial rows, one more at the end.
    partial_start: Vec<usize>,
    /// Copies of row i: `copies[copy_start[i]..copy_start[i + 1]]`, places in the array of all partial rows.
    copy_start: Vec<usize>,
    copies: Vec<usize>,
    /// Place of each product of an element's lower triangle within its group's rows; the element's starts at
    /// `slot_start`.
    slot_start: Vec<usize>,
    slots: Vec<u32>,
}

/// For every element the functions that act on it, in the order of its factors.
struct Lists {
    start: Vec<usize>,
    functions: Vec<u32>,
}

impl Lists {
    fn new<const D: usize>(elements: &Elements<D>) -> Self {
        let (start, functions) = elements.functions();
        Self { start, functions }
    }

    fn len(&self) -> usize {
        self.start.len() - 1
    }

    fn of(&self, element: usize) -> &[u32] {
        &self.functions[self.start[element]..self.start[element + 1]]
    }
}

/// For every function the elements that it acts on and its number there.
struct Owners {
    start: Vec<usize>,
    owner: Vec<(u32, u32)>,
}

/// A row of the matrix in one group: the function, its owners in the group, and where the row starts.
struct GroupRow {
    function: u32,
    owners: Range<usize>,
    offset: u32,
}

impl Pattern {
    pub fn new<const D: usize>(elements: &Elements<D>, functions: usize) -> Result<Self> {
        let mut slot_start = Vec::with_capacity(elements.len() + 1);
        let mut products = 0;
        let elements = Lists::new(elements);
        for e in 0..elements.len() {
            slot_start.push(products);
            let k = elements.of(e).len();
            products += k * (k + 1) / 2;
        }
        slot_start.push(products);
        if products > MAX_PRODUCTS {
            return Err(KernelError::TooLarge(format!(
                "the normal equations would take {products} element products (limit {MAX_PRODUCTS}); use a coarser mesh"
            )));
        }
        let owners = transpose(&elements, functions);
        let (row_start, columns) = neighbours(&elements, functions, &owners);
        let (lower_start, lower_of) = lower_triangle(&row_start, &columns);
        let group = elements.len().div_ceil(GROUPS).max(GROUP);
        let mut pattern = Self {
            row_start,
            columns,
            lower_of,
            lower_start,
            group,
            partial_start: vec![0],
            copy_start: vec![0],
            copies: Vec::new(),
            slot_start,
            slots: vec![0; products],
        };
        let rows = pattern.group_rows(&owners, elements.len().div_ceil(group));
        pattern.fill_slots(&elements, &owners, &rows);
        Ok(pattern)
    }

    pub fn size(&self) -> usize {
        self.row_start.len() - 1
    }

    pub fn row(&self, i: usize) -> &[u32] {
        &self.columns[self.row_start[i]..self.row_start[i + 1]]
    }

    /// Columns of row i in the lower triangle; the diagonal is the last.
    fn lower_row(&self, i: usize) -> &[u32] {
        &self.columns[self.row_start[i]..][..self.lower_start[i + 1] - self.lower_start[i]]
    }

    /// Length of the array of all partial rows.
    pub fn partial_len(&self) -> usize {
        self.partial_start[self.partial_start.len() - 1]
    }

    /// The groups' elements, each with its part of the array of all partial rows.
    pub fn groups<'a>(&self, mut partial: &'a mut [f64]) -> Vec<(Range<usize>, &'a mut [f64])> {
        let elements = self.slot_start.len() - 1;
        (0..elements)
            .step_by(self.group)
            .zip(self.partial_start.windows(2))
            .map(|(e, ends)| {
                let (mine, rest) = std::mem::take(&mut partial).split_at_mut(ends[1] - ends[0]);
                partial = rest;
                (e..(e + self.group).min(elements), mine)
            })
            .collect()
    }

    /// Places of an element's products within its group's rows, its lower triangle row by row. The right-hand side's
    /// place follows that of the diagonal.
    #[inline]
    pub fn slots(&self, element: usize) -> &[u32] {
        &self.slots[self.slot_start[element]..self.slot_start[element + 1]]
    }

    /// Lower triangle and right-hand side from the groups' rows.
    pub fn gather(&self, partial: &[f64], lower: &mut [f64], rhs: &mut [f64]) {
        let mut rest = lower;
        let tasks: Vec<_> = rhs
            .chunks_mut(512)
            .enumerate()
            .map(|(k, rhs)| {
                let (first, end) = (512 * k, 512 * k + rhs.len());
                let length = self.lower_start[end] - self.lower_start[first];
                let (mine, other) = std::mem::take(&mut rest).split_at_mut(length);
                rest = other;
                (first, mine, rhs)
            })
            .collect();
        tasks.into_par_iter().for_each(|(first, lower, rhs)| {
            for (i, rhs) in (first..).zip(rhs) {
                let (begin, end) = (
                    self.lower_start[i] - self.lower_start[first],
                    self.lower_start[i + 1] - self.lower_start[first],
                );
                let row = &mut lower[begin..end];
                row.fill(0.0);
                *rhs = 0.0;
                for &at in &self.copies[self.copy_start[i]..self.copy_start[i + 1]] {
                    for (sum, x) in row.iter_mut().zip(&partial[at..]) {
                        *sum += x;
                    }
                    *rhs += partial[at + row.len()];
                }
            }
        });
    }

    /// The full matrix's entries from the lower triangle's.
    pub fn mirror(&self, lower: &[f64], full: &mut [f64]) {
        full.par_chunks_mut(8192)
            .zip(self.lower_of.par_chunks(8192))
            .for_each(|(out, from)| {
                for (value, &k) in out.iter_mut().zip(from) {
                    *value = lower[k as usize];
                }
            });
    }

    /// Lay out every group's rows.
    fn group_rows(&mut self, owners: &Owners, groups: usize) -> Vec<Vec<GroupRow>> {
        let mut rows: Vec<Vec<GroupRow>> = (0..groups).map(|_| Vec::new()).collect();
        let mut length = vec![0_usize; groups];
        let mut copies = Vec::new();
        for i in 0..self.size() {
            let (mut at, end) = (owners.start[i], owners.start[i + 1]);
            let row = self.lower_start[i + 1] - self.lower_start[i] + 1;
            while at < end {
                let group = owners.owner[at].0 as usize / self.group;
                let count = owners.owner[at..end]
                    .iter()
                    .take_while(|o| o.0 as usize / self.group == group)
                    .count();
                let offset = length[group];
                rows[group].push(GroupRow {
                    function: i as u32,
                    owners: at..at + count,
                    offset: offset as u32,
                });
                copies.push((group, offset));
                length[group] += row;
                at += count;
            }
            self.copy_start.push(copies.len());
        }
        for (g, n) in length.into_iter().enumerate() {
            self.partial_start.push(self.partial_start[g] + n);
        }
        self.copies = copies
            .into_iter()
            .map(|(g, offset)| self.partial_start[g] + offset)
            .collect();
        rows
    }

    fn fill_slots(&mut self, elements: &Lists, owners: &Owners, rows: &[Vec<GroupRow>]) {
        let mut slots = std::mem::take(&mut self.slots);
        let mut rest = slots.as_mut_slice();
        let mut tasks = Vec::with_capacity(rows.len());
        for (g, rows) in rows.iter().enumerate() {
            let (first, end) = (g * self.group, ((g + 1) * self.group).min(elements.len()));
            let (mine, other) = rest.split_at_mut(self.slot_start[end] - self.slot_start[first]);
            tasks.push((self.slot_start[first], mine, rows));
            rest = other;
        }
        tasks.into_par_iter().for_each_init(
            || vec![0_u32; self.size()],
            |place, (begin, out, rows)| {
                for row in rows {
                    let i = row.function;
                    for (at, &j) in (row.offset..).zip(self.lower_row(i as usize)) {
                        place[j as usize] = at;
                    }
                    for &(e, a) in &owners.owner[row.owners.clone()] {
                        let (start, a) = (self.slot_start[e as usize] - begin, a as usize);
                        for (b, &j) in elements.of(e as usize).iter().enumerate() {
                            if j <= i {
                                let (high, low) = (a.max(b), a.min(b));
                                out[start + high * (high + 1) / 2 + low] = place[j as usize];
                            }
                        }
                    }
                }
            },
        );
        self.slots = slots;
    }
}

fn transpose(elements: &Lists, functions: usize) -> Owners {
    let mut start = vec![0_usize; functions + 1];
    for e in 0..elements.len() {
        for &i in elements.of(e) {
            start[i as usize + 1] += 1;
        }
    }
    for i in 0..functions {
        start[i + 1] += start[i];
    }
    let mut fill = start.clone();
    let mut owner = vec![(0, 0); start[functions]];
    for e in 0..elements.len() {
        for (a, &i) in elements.of(e).iter().enumerate() {
            let at = &mut fill[i as usize];
            owner[*at] = (e as u32, a as u32);
            *at += 1;
        }
    }
    Owners { start, owner }
}

/// Columns of the full matrix, row after row, ascending.
fn neighbours(elements: &Lists, functions: usize, owners: &Owners) -> (Vec<usize>, Vec<u32>) {
    let numbers: Vec<u32> = (0..functions as u32).collect();
    let blocks: Vec<(Vec<u32>, Vec<u32>)> = numbers
        .par_chunks(512)
        .map_init(
            || vec![u32::MAX; functions],
            |seen, rows| {
                let (mut lengths, mut columns) = (
                    Vec::with_capacity(rows.len()),
                    Vec::with_capacity(64 * rows.len()),
                );
                for &i in rows {
                    let begin = columns.len();
                    for &(e, _) in &owners.owner[owners.start[i as usize]..owners.start[i as usize + 1]] {
                        for &j in elements.of(e as usize) {
                            let mark = &mut seen[j as usize];
                            if *mark != i {
                                *mark = i;
                                columns.push(j);
                            }
                        }
                    }
                    columns[begin..].sort_unstable();
                    lengths.push((columns.len() - begin) as u32);
                }
                (lengths, columns)
            },
        )
        .collect();
    let mut row_start = Vec::with_capacity(functions + 1);
    let mut end = 0;
    row_start.push(0);
    for length in blocks.iter().flat_map(|b| &b.0) {
        end += *length as usize;
        row_start.push(end);
    }
    let mut columns = Vec::with_capacity(end);
    for block in blocks {
        columns.extend(block.1);
    }
    (row_start, columns)
}

fn lower_triangle(row_start: &[usize], columns: &[u32]) -> (Vec<usize>, Vec<u32>) {
    let n = row_start.len() - 1;
    let mut lower_start = Vec::with_capacity(n + 1);
    lower_start.push(0);
    for i in 0..n {
        let below = columns[row_start[i]..row_start[i + 1]].partition_point(|&j| j as usize <= i);
        lower_start.push(lower_start[i] + below);
    }
    // Going through the rows in order, the upper entries of row i come up as the next unused lower entries of column i.
    let mut lower_of = vec![0; columns.len()];
    let mut fill = vec![0_usize; n];
    for i in 0..n {
        for (k, at) in (row_start[i]..row_start[i + 1]).enumerate() {
            let j = columns[at] as usize;
            if j <= i {
                lower_of[at] = (lower_start[i] + k) as u32;
                if j < i {
                    let upper = row_start[j] + (lower_start[j + 1] - lower_start[j]) + fill[j];
                    lower_of[upper] = lower_of[at];
                    fill[j] += 1;
                }
            }
        }
    }
    (lower_start, lower_of)
}
