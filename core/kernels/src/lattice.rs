//! One level of a hierarchy of cubic B-splines: the coefficients near chosen cells of a uniform lattice.
//!
//! Level l cuts the unit box into 2^l cells an axis; node (i, j, k) carries the uniform cubic B-spline centred at
//! (i - 1, j - 1, k - 1) / 2^l, i = 0..2^l + 2, and covers the cells i - 3..=i. Nodes are stored column by column
//! (k runs fastest) in runs without holes, so that the four nodes that a cell needs of a column lie side by side.

use rayon::prelude::*;

use crate::error::{KernelError, Result};

/// Nodes or cells `start..end` of a column.
pub type Span = (u32, u32);

/// The deepest level of a lattice: columns are held in a table of (2^l + 3)^2 entries.
pub const DEEPEST: u8 = 11;

/// Nodes beyond the four of a solved cell that are kept on either side, so that every cell that a solved node's function
/// touches can be evaluated.
const MARGIN: u32 = 3;

/// A run of nodes of one column: `nodes` by their places, the first one's number.
#[derive(Debug, Clone, Copy)]
struct Run {
    start: u32,
    end: u32,
    first: u32,
}

/// The stored nodes of a level, their coefficients, and which of them are solved for.
#[derive(Debug, Clone)]
pub struct Lattice {
    level: u8,
    side: u32,
    column: Vec<u32>,
    runs: Vec<Run>,
    pub coefficients: Vec<f64>,
    /// Nodes that are solved for: those whose function touches a solved cell.
    pub active: Vec<bool>,
}

impl Lattice {
    /// The lattice that solves for the functions on `cells` (any order, repeats allowed).
    pub fn new(level: u8, cells: &[[u32; 3]]) -> Result<Self> {
        if level > DEEPEST {
            return Err(KernelError::TooLarge(format!(
                "level: found {level}, accepted is 0 to {DEEPEST}"
            )));
        }
        let n = 1u32 << level;
        if cells.iter().flatten().any(|&c| c >= n) {
            return Err(KernelError::Invalid(format!("cells: a cell outside of 0..{n}")));
        }
        let side = n + 3;
        let by_column = cell_spans(n, cells);
        let stored = dilated(&by_column, n, side, MARGIN, MARGIN + 4);
        let mut column = Vec::with_capacity((side * side) as usize + 1);
        let mut runs = Vec::new();
        let mut count = 0u64;
        column.push(0);
        for spans in &stored {
            for &(start, end) in spans {
                runs.push(Run {
                    start,
                    end,
                    first: count as u32,
                });
                count += u64::from(end - start);
            }
            column.push(runs.len() as u32);
        }
        if count >= u64::from(u32::MAX) {
            return Err(KernelError::TooLarge("the lattice exceeds 2^32 nodes".into()));
        }
        let mut lattice = Self {
            level,
            side,
            column,
            runs,
            coefficients: vec![0.0; count as usize],
            active: vec![false; count as usize],
        };
        let solved = dilated(&by_column, n, side, 0, 4);
        for (c, spans) in solved.iter().enumerate() {
            for &(start, end) in spans {
                let first = lattice.find(c, start).ok_or_else(lost)?;
                lattice.active[first as usize..(first + end - start) as usize].fill(true);
            }
        }
        Ok(lattice)
    }

    /// Level l: cells have side 2^-l.
    pub fn level(&self) -> u8 {
        self.level
    }

    /// Nodes an axis.
    pub fn side(&self) -> u32 {
        self.side
    }

    /// Stored nodes.
    pub fn len(&self) -> usize {
        self.coefficients.len()
    }

    /// Whether nothing is stored.
    pub fn is_empty(&self) -> bool {
        self.coefficients.is_empty()
    }

    /// Number of node (i, j, k), if it is stored.
    pub fn index(&self, i: u32, j: u32, k: u32) -> Option<u32> {
        if i >= self.side || j >= self.side {
            return None;
        }
        self.find((i * self.side + j) as usize, k)
    }

    /// Number of the first of the nodes k..k + 4 of the column (i, j), if all are stored.
    fn four(&self, i: u32, j: u32, k: u32) -> Option<u32> {
        let run = self.run((i * self.side + j) as usize, k)?;
        (k + 4 <= run.end).then(|| run.first + (k - run.start))
    }

    /// The 16 columns of the functions on a cell: the number of the first of four nodes each; none when one is missing.
    pub fn cell(&self, cell: [u32; 3]) -> Option<[u32; 16]> {
        let mut base = [0; 16];
        for (q, b) in base.iter_mut().enumerate() {
            *b = self.four(cell[0] + q as u32 / 4, cell[1] + q as u32 % 4, cell[2])?;
        }
        Some(base)
    }

    /// Cell of a point of the unit box, and the point's place in it.
    pub fn locate(&self, x: &[f64; 3]) -> ([u32; 3], [f64; 3]) {
        let n = f64::from(1u32 << self.level);
        let cell: [u32; 3] = std::array::from_fn(|a| (x[a] * n).floor().clamp(0.0, n - 1.0) as u32);
        (cell, std::array::from_fn(|a| x[a] * n - f64::from(cell[a])))
    }

    /// Take the coefficients over from the next coarser level: the same function, as uniform cubic splines nest.
    pub fn prolong(&mut self, coarse: &Self) -> Result<()> {
        debug_assert_eq!(coarse.level + 1, self.level);
        let side = self.side as usize;
        let mut rest = self.coefficients.as_mut_slice();
        let mut pieces = Vec::with_capacity(self.runs.len());
        for c in 0..side * side {
            for run in &self.runs[self.column[c] as usize..self.column[c + 1] as usize] {
                let (now, later) = rest.split_at_mut((run.end - run.start) as usize);
                rest = later;
                pieces.push(((c / side) as u32, (c % side) as u32, *run, now));
            }
        }
        pieces
            .into_par_iter()
            .with_min_len(64)
            .try_for_each(|(i, j, run, out)| {
                for (p, wi) in parents(i) {
                    for (q, wj) in parents(j) {
                        let low = parents(run.start)[0].0;
                        let high = parents(run.end - 1).iter().map(|&(k, _)| k).max().unwrap_or(low);
                        let first = coarse.index(p, q, low).ok_or_else(lost)? as usize;
                        if coarse.index(p, q, high) != Some(first as u32 + high - low) {
                            return Err(lost());
                        }
                        let line = &coarse.coefficients[first..=first + (high - low) as usize];
                        for (o, k) in out.iter_mut().zip(run.start..run.end) {
                            let sum: f64 = parents(k)
                                .iter()
                                .map(|&(r, w)| w * line[(r - low) as usize])
                                .sum();
                            *o += wi * wj * sum;
                        }
                    }
                }
                Ok(())
            })
    }

    /// Numbers of the six neighbours of every node, -i, +i, -j, +j, -k, +k; `u32::MAX` where none is stored.
    pub fn neighbours(&self) -> Vec<[u32; 6]> {
        let side = self.side as usize;
        let mut out = vec![[u32::MAX; 6]; self.len()];
        for c in 0..side * side {
            let (i, j) = (c / side, c % side);
            let beside = [
                (i > 0).then(|| c - side),
                (i + 1 < side).then_some(c + side),
                (j > 0).then(|| c - 1),
                (j + 1 < side).then_some(c + 1),
            ];
            for run in &self.runs[self.column[c] as usize..self.column[c + 1] as usize] {
                let end = run.first + run.end - run.start;
                for at in run.first..end - 1 {
                    out[at as usize][5] = at + 1;
                    out[at as usize + 1][4] = at;
                }
                for (a, other) in beside.iter().enumerate() {
                    let Some(other) = other else { continue };
                    let range = self.column[*other] as usize..self.column[*other + 1] as usize;
                    for there in &self.runs[range] {
                        let (low, high) = (run.start.max(there.start), run.end.min(there.end));
                        for k in low..high {
                            out[(run.first + k - run.start) as usize][a] = there.first + k - there.start;
                        }
                    }
                }
            }
        }
        out
    }

    fn run(&self, column: usize, k: u32) -> Option<&Run> {
        let runs = &self.runs[self.column[column] as usize..self.column[column + 1] as usize];
        let at = runs.partition_point(|run| run.end <= k);
        runs.get(at).filter(|run| run.start <= k)
    }

    fn find(&self, column: usize, k: u32) -> Option<u32> {
        self.run(column, k).map(|run| run.first + (k - run.start))
    }
}

fn lost() -> KernelError {
    KernelError::Invalid("cells: a cell whose parent was not solved on the coarser level".into())
}

/// The nodes of the coarser level whose functions make up fine node `i`, and their shares (a missing one has share 0).
fn parents(i: u32) -> [(u32, f64); 3] {
    // Node i stands at i - 1 fine cells; coarse node j at 2 (j - 1).
    let half = i / 2;
    if i % 2 == 1 {
        [(half, 0.125), (half + 1, 0.75), (half + 2, 0.125)]
    } else {
        [(half, 0.5), (half + 1, 0.5), (half + 1, 0.0)]
    }
}

/// The cells of a lattice of n cells an axis that are at most `radius` cells away from `cells`, sorted.
pub fn around(cells: &[[u32; 3]], n: u32, radius: u32) -> Result<Vec<[u32; 3]>> {
    if n > 1 << DEEPEST || cells.iter().flatten().any(|&c| c >= n) {
        return Err(KernelError::Invalid(format!(
            "cells: a cell outside of 0..{n}, of at most {} an axis",
            1 << DEEPEST
        )));
    }
    let radius = radius.min(n);
    let spans = dilated(&cell_spans(n, cells), n, n, radius, radius + 1);
    Ok(spans
        .iter()
        .enumerate()
        .flat_map(|(c, spans)| {
            let (i, j) = (c as u32 / n, c as u32 % n);
            spans
                .iter()
                .flat_map(move |&(a, b)| (a..b).map(move |k| [i, j, k]))
        })
        .collect())
}

/// Spans of cells along k for every column of cells.
fn cell_spans(n: u32, cells: &[[u32; 3]]) -> Vec<Vec<Span>> {
    let mut sorted = cells.to_vec();
    sorted.par_sort_unstable();
    sorted.dedup();
    let mut out = vec![Vec::new(); (n * n) as usize];
    for cell in sorted {
        let spans: &mut Vec<Span> = &mut out[(cell[0] * n + cell[1]) as usize];
        match spans.last_mut() {
            Some(last) if last.1 == cell[2] => last.1 += 1,
            _ => spans.push((cell[2], cell[2] + 1)),
        }
    }
    out
}

/// Node spans of every column of nodes: cell c spreads to the nodes c - `before`..c + `after` on every axis.
fn dilated(cells: &[Vec<Span>], n: u32, side: u32, before: u32, after: u32) -> Vec<Vec<Span>> {
    let along_k: Vec<Vec<Span>> = cells
        .par_iter()
        .map(|spans| {
            let wide = |&(a, b): &Span| (a.saturating_sub(before), (b - 1 + after).min(side));
            merged(spans.iter().map(wide).collect())
        })
        .collect();
    // Node column i gathers the cell columns i - after + 1..=i + before.
    let gather = |i: u32| (i + 1).saturating_sub(after).min(n)..(i + before + 1).min(n);
    let along_j: Vec<Vec<Span>> = (0..n * side)
        .into_par_iter()
        .map(|at| {
            let (i, j) = (at / side, at % side);
            let spans = gather(j).flat_map(|c| along_k[(i * n + c) as usize].iter().copied());
            merged(spans.collect())
        })
        .collect();
    (0..side * side)
        .into_par_iter()
        .map(|at| {
            let (i, j) = (at / side, at % side);
            let spans = gather(i).flat_map(|c| along_j[(c * side + j) as usize].iter().copied());
            merged(spans.collect())
        })
        .collect()
}

/// The union of spans, in order.
fn merged(mut spans: Vec<Span>) -> Vec<Span> {
    spans.sort_unstable();
    let mut out: Vec<Span> = Vec::with_capacity(spans.len().min(4));
    for (a, b) in spans {
        match out.last_mut() {
            Some(last) if a <= last.1 => last.1 = last.1.max(b),
            _ => out.push((a, b)),
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn nodes_are_numbered_column_by_column() {
        let lattice = Lattice::new(3, &[[0, 7, 2], [0, 7, 2], [1, 2, 7]]).unwrap();
        let mut count = 0;
        for i in 0..11 {
            for j in 0..11 {
                for k in 0..11 {
                    let near = |c: [u32; 3], low: u32, high: u32| {
                        [i, j, k]
                            .iter()
                            .zip(c)
                            .all(|(&q, c)| q + low >= c && q < c + high)
                    };
                    let stored = near([0, 7, 2], 3, 7) || near([1, 2, 7], 3, 7);
                    assert_eq!(lattice.index(i, j, k), stored.then_some(count));
                    if stored {
                        let solved = near([0, 7, 2], 0, 4) || near([1, 2, 7], 0, 4);
                        assert_eq!(lattice.active[count as usize], solved);
                        count += 1;
                    }
                }
            }
        }
        assert_eq!(lattice.len(), count as usize);
    }

    #[test]
    fn linear_coefficients_stay_linear() {
        let mut coarse = Lattice::new(2, &[[1, 2, 3]]).unwrap();
        // Node i stands at (i - 1) / 2^l.
        let f = |at: [u32; 3], n: f64| {
            let x = at.map(|q| (f64::from(q) - 1.0) / n);
            0.5 + x[0] - 2.0 * x[1] + 3.0 * x[2]
        };
        let fill = |lattice: &Lattice, n: f64| {
            let mut out = vec![0.0; lattice.len()];
            let side = lattice.side();
            for at in (0..side.pow(3)).map(|q| [q / (side * side), q / side % side, q % side]) {
                if let Some(place) = lattice.index(at[0], at[1], at[2]) {
                    out[place as usize] = f(at, n);
                }
            }
            out
        };
        coarse.coefficients = fill(&coarse, 4.0);
        let mut fine = Lattice::new(3, &[[2, 5, 6], [3, 4, 7]]).unwrap();
        fine.prolong(&coarse).unwrap();
        for (found, told) in fine.coefficients.iter().zip(fill(&fine, 8.0)) {
            assert!((found - told).abs() < 1e-14);
        }
    }

    #[test]
    fn neighbours_are_one_step_away() {
        let lattice = Lattice::new(2, &[[0, 0, 0], [3, 3, 3]]).unwrap();
        let neighbours = lattice.neighbours();
        for (i, j, k) in (0..343).map(|q| (q / 49, q / 7 % 7, q % 7)) {
            let Some(place) = lattice.index(i, j, k) else {
                continue;
            };
            let step = |i: u32, j: u32, k: u32| lattice.index(i, j, k).unwrap_or(u32::MAX);
            // Below 0 the number wraps to one that no node has.
            let told = [
                step(i.wrapping_sub(1), j, k),
                step(i + 1, j, k),
                step(i, j.wrapping_sub(1), k),
                step(i, j + 1, k),
                step(i, j, k.wrapping_sub(1)),
                step(i, j, k + 1),
            ];
            assert_eq!(neighbours[place as usize], told);
        }
    }
}
