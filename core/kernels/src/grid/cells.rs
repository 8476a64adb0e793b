//! Which cells of a grid the zero set of the interpolant may pass.
//!
//! On a cell the interpolant is a mean of the B-spline coefficients around it: where these have one sign, it has it too.
//! Blocks that lie further than one block from any stored one hold a constant.

use rayon::prelude::*;

use super::blocks::{Blocks, Neighbor, SIDE};

/// Nodes an axis that the coefficients around a block's cells follow from: two below, three above.
const SPAN: usize = SIDE + 5;
/// Coefficients an axis around a block's cells, and around one cell.
const KNOTS: usize = SIDE + 3;
const AROUND: usize = 4;

/// Cells, by their lowest nodes, whose coefficients do not all lie beyond `margin` on one side. Those on the border of the
/// grid are left out only if they are outside: the border closes the shape.
pub fn live<const D: usize>(blocks: &Blocks<D>, margin: f64) -> Vec<[u32; D]> {
    let candidates = candidates(blocks);
    candidates
        .par_chunks(16)
        .flat_map_iter(|places| {
            let mut work = Work::new();
            let mut out = Vec::new();
            for place in places {
                work.cells(blocks, place, margin, &mut out);
            }
            out
        })
        .collect()
}

/// Blocks on which the interpolant is no constant, or that the border cuts.
fn candidates<const D: usize>(blocks: &Blocks<D>) -> Vec<[i64; D]> {
    let counts = blocks.counts();
    let number: usize = counts.iter().product();
    let mut marks = vec![false; number];
    let mut mark = |place: &[i64; D], radius: i64| {
        let side = 2 * radius + 1;
        for k in 0..side.pow(D as u32) {
            let mut rest = k;
            let near: [i64; D] = std::array::from_fn(|a| {
                let step = rest % side - radius;
                rest /= side;
                place[a] + step
            });
            if (0..D).all(|a| near[a] >= 0 && near[a] < counts[a] as i64) {
                marks[near.iter().zip(&counts).fold(0, |b, (&p, &n)| b * n + p as usize)] = true;
            }
        }
    };
    for b in 0..number {
        let place = place_of(b, &counts);
        let own = blocks.block(place);
        if matches!(own, Neighbor::Slot(_)) {
            mark(&place, 1);
            continue;
        }
        if own == Neighbor::Inside && (0..D).any(|a| place[a] == 0 || place[a] + 1 == counts[a] as i64) {
            mark(&place, 0);
        }
        for a in 0..D {
            let mut next = place;
            next[a] += 1;
            let other = blocks.block(next);
            if matches!(other, Neighbor::Inside | Neighbor::Outside) && other != own {
                mark(&place, 1);
                mark(&next, 1);
            }
        }
    }
    (0..number)
        .filter(|&b| marks[b])
        .map(|b| place_of(b, &counts))
        .collect()
}

fn place_of<const D: usize>(mut b: usize, counts: &[usize; D]) -> [i64; D] {
    let mut place = [0; D];
    for a in (0..D).rev() {
        place[a] = (b % counts[a]) as i64;
        b /= counts[a];
    }
    place
}

/// Arrays of one thread, `SPAN^D` entries each.
struct Work<const D: usize> {
    values: Vec<f64>,
    least: Vec<f64>,
}

impl<const D: usize> Work<D> {
    fn new() -> Self {
        let volume = SPAN.pow(D as u32);
        Self {
            values: vec![0.0; volume],
            least: vec![0.0; volume],
        }
    }

    fn cells(&mut self, blocks: &Blocks<D>, place: &[i64; D], margin: f64, out: &mut Vec<[u32; D]>) {
        let shape = blocks.shape();
        self.gather(blocks, place);
        for a in 0..D {
            self.extend(a, place[a] * SIDE as i64 - 2, shape[a] as i64 - 1);
        }
        for a in 0..D {
            let axis = Lines::<D>::along(a);
            axis.map(&mut self.values, KNOTS, |v, k, s| {
                (8.0 * v[k + s] - v[k] - v[k + 2 * s]) * (1.0 / 6.0)
            });
        }
        let border = (0..D).any(|a| place[a] == 0 || (place[a] + 1) as usize == blocks.counts()[a]);
        let (mut low, mut high) = (f64::INFINITY, f64::NEG_INFINITY);
        each::<D>(KNOTS, |at| {
            low = low.min(self.values[at]);
            high = high.max(self.values[at]);
        });
        if low > margin || (high < -margin && !border) {
            return;
        }
        self.least.copy_from_slice(&self.values);
        for a in 0..D {
            let axis = Lines::<D>::along(a);
            axis.map(&mut self.least, SIDE, |v, k, s| {
                (1..AROUND).fold(v[k], |m, q| m.min(v[k + q * s]))
            });
            axis.map(&mut self.values, SIDE, |v, k, s| {
                (1..AROUND).fold(v[k], |m, q| m.max(v[k + q * s]))
            });
        }
        each::<D>(SIDE, |at| {
            let mut rest = at;
            let mut cell = [0; D];
            for a in (0..D).rev() {
                cell[a] = place[a] as usize * SIDE + rest % SPAN;
                rest /= SPAN;
            }
            let on_border = (0..D).any(|a| cell[a] == 0 || cell[a] + 2 == shape[a]);
            let settled = self.least[at] > margin || (self.values[at] < -margin && !on_border);
            if !settled && (0..D).all(|a| cell[a] + 1 < shape[a]) {
                out.push(cell.map(|x| x as u32));
            }
        });
    }

    /// Node values around a block; what lies beyond the grid is left as it is.
    fn gather(&mut self, blocks: &Blocks<D>, place: &[i64; D]) {
        const PARTS: [[usize; 3]; 3] = [[SIDE - 2, 0, 2], [0, 2, SIDE], [0, SIDE + 2, 3]];
        for k in 0..3_usize.pow(D as u32) {
            let mut rest = k;
            let step: [usize; D] = std::array::from_fn(|_| {
                let s = rest % 3;
                rest /= 3;
                s
            });
            let fill = match blocks.block(std::array::from_fn(|a| place[a] + step[a] as i64 - 1)) {
                Neighbor::Border => continue,
                Neighbor::Outside => Err(blocks.far()),
                Neighbor::Inside => Err(-blocks.far()),
                Neighbor::Slot(slot) => Ok(slot as usize * Blocks::<D>::VOLUME),
            };
            let part = step.map(|s| PARTS[s]);
            let rows: usize = part[..D - 1].iter().map(|p| p[2]).product();
            for mut row in 0..rows {
                let (mut from, mut to, mut scale, mut wide) = (part[D - 1][0], part[D - 1][1], SIDE, SPAN);
                for a in (0..D - 1).rev() {
                    let at = row % part[a][2];
                    row /= part[a][2];
                    from += (part[a][0] + at) * scale;
                    to += (part[a][1] + at) * wide;
                    scale *= SIDE;
                    wide *= SPAN;
                }
                let target = &mut self.values[to..to + part[D - 1][2]];
                match fill {
                    Ok(base) => {
                        target.copy_from_slice(&blocks.values()[base + from..base + from + part[D - 1][2]]);
                    }
                    Err(value) => target.fill(value),
                }
            }
        }
    }

    /// Let values go on linearly along an axis beyond the nodes from 0 to `last`; `first` is the window's first node.
    fn extend(&mut self, axis: usize, first: i64, last: i64) {
        if first >= 0 && first + SPAN as i64 - 1 <= last {
            return;
        }
        let lines = Lines::<D>::along(axis);
        let (low, high) = ((-first).max(0) as usize, (last - first) as usize);
        lines.each(|start, s| {
            let at = |k: usize| start + k * s;
            let v = &mut self.values;
            for k in 0..low {
                v[at(k)] = v[at(low)] + (low - k) as f64 * (v[at(low)] - v[at(low + 1)]);
            }
            for k in high + 1..SPAN {
                v[at(k)] = v[at(high)] + (k - high) as f64 * (v[at(high)] - v[at(high - 1)]);
            }
        });
    }
}

/// Lines of a window along one axis.
struct Lines<const D: usize> {
    stride: usize,
}

impl<const D: usize> Lines<D> {
    fn along(axis: usize) -> Self {
        Self {
            stride: SPAN.pow((D - 1 - axis) as u32),
        }
    }

    /// Visit the first entry of each line and the step along it.
    fn each(&self, mut visit: impl FnMut(usize, usize)) {
        let s = self.stride;
        for outer in (0..SPAN.pow(D as u32)).step_by(s * SPAN) {
            for inner in 0..s {
                visit(outer + inner, s);
            }
        }
    }

    /// Replace the first `count` entries of each line, ascending, by a function of themselves and those after them.
    fn map(&self, values: &mut [f64], count: usize, new: impl Fn(&[f64], usize, usize) -> f64) {
        let s = self.stride;
        for outer in (0..values.len()).step_by(s * SPAN) {
            for k in 0..count {
                for inner in 0..s {
                    let at = outer + k * s + inner;
                    values[at] = new(values, at, s);
                }
            }
        }
    }
}

/// Visit the entries of a window whose places along all axes are below `count`, in C order.
fn each<const D: usize>(count: usize, mut visit: impl FnMut(usize)) {
    for mut k in 0..count.pow(D as u32) {
        let (mut at, mut stride) = (0, 1);
        for _ in 0..D {
            at += k % count * stride;
            k /= count;
            stride *= SPAN;
        }
        visit(at);
    }
}
