//! Which cells of a grid the zero set of the interpolant may pass.
//!
//! On a cell the interpolant is a mean of the B-spline coefficients around it, and of its Bernstein coefficients there: where
//! these have one sign, it has it too.
//! Blocks that lie further than one block from any stored one hold a constant.

use multiversion::multiversion;
use rayon::prelude::*;

use super::blocks::{Blocks, Neighbor, SIDE};
use super::screen::Screen;

/// Nodes an axis that the coefficients around a block's cells follow from: two below, three above.
const SPAN: usize = SIDE + 5;
/// Coefficients an axis around a block's cells, and around one cell.
const KNOTS: usize = SIDE + 3;
const AROUND: usize = 4;

/// Cells, by their lowest nodes, whose Bernstein coefficients do not all lie beyond `margin` on one side. Those on the border of the
/// grid are left out only if they are outside: the border closes the shape.
pub fn live<const D: usize>(blocks: &Blocks<D>, margin: f64) -> Vec<[u32; D]> {
    let places = Screen::new(blocks).crossed(&candidates(blocks), margin);
    places
        .par_chunks(16)
        .flat_map_iter(|places| {
            let mut out = Vec::new();
            cells_of(blocks, places, margin, &mut out);
            out
        })
        .collect()
}

#[multiversion(targets("x86_64+avx+avx2"))]
fn cells_of<const D: usize>(
    blocks: &Blocks<D>,
    places: &[([i64; D], f64)],
    margin: f64,
    out: &mut Vec<[u32; D]>,
) {
    let mut work = Work::new();
    for (place, reach) in places {
        work.cells(blocks, place, *reach, margin, out);
    }
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
    largest: Vec<f64>,
}

impl<const D: usize> Work<D> {
    fn new() -> Self {
        let volume = SPAN.pow(D as u32);
        Self {
            values: vec![0.0; volume],
            least: vec![0.0; volume],
            largest: vec![0.0; volume],
        }
    }

    #[inline(always)]
    fn cells(
        &mut self,
        blocks: &Blocks<D>,
        place: &[i64; D],
        reach: f64,
        margin: f64,
        out: &mut Vec<[u32; D]>,
    ) {
        let shape = blocks.shape();
        self.gather(blocks, place);
        let [low, high] = range(&self.values);
        if low > reach || high < -reach {
            return;
        }
        for a in 0..D {
            self.extend(a, place[a] * SIDE as i64 - 2, shape[a] as i64 - 1);
        }
        for a in 0..D {
            let axis = Lines::<D>::along(a);
            axis.map(&mut self.values, KNOTS, |v: [f64; 3]| {
                (8.0 * v[1] - v[0] - v[2]) * (1.0 / 6.0)
            });
        }
        let border = (0..D).any(|a| place[a] == 0 || (place[a] + 1) as usize == blocks.counts()[a]);
        let (mut low, mut high) = (f64::INFINITY, f64::NEG_INFINITY);
        each::<D>(KNOTS, |at| {
            let v = self.values[at];
            low = if v < low { v } else { low };
            high = if v > high { v } else { high };
        });
        if low > margin || (high < -margin && !border) {
            return;
        }
        self.least.copy_from_slice(&self.values);
        self.largest.copy_from_slice(&self.values);
        for a in 0..D {
            let axis = Lines::<D>::along(a);
            // Numbers alone: comparisons compile to one instruction where `min` has to look for NaN.
            axis.map(&mut self.least, SIDE, |v: [f64; AROUND]| {
                v.into_iter()
                    .reduce(|m, x| if x < m { x } else { m })
                    .unwrap_or(0.0)
            });
            axis.map(&mut self.largest, SIDE, |v: [f64; AROUND]| {
                v.into_iter()
                    .reduce(|m, x| if x > m { x } else { m })
                    .unwrap_or(0.0)
            });
        }
        // Plain loops: a closure would not be compiled for the processor at hand.
        for i in 0..if D == 3 { SIDE } else { 1 } {
            for row in 0..SIDE {
                for k in 0..SIDE {
                    let at = (i * SPAN + row) * SPAN + k;
                    let local = [i, row, k];
                    let cell: [usize; D] =
                        std::array::from_fn(|a| place[a] as usize * SIDE + local[3 - D + a]);
                    let on_border = (0..D).any(|a| cell[a] == 0 || cell[a] + 2 == shape[a]);
                    let settled = |[low, high]: [f64; 2]| low > margin || (high < -margin && !on_border);
                    if settled([self.least[at], self.largest[at]])
                        || (0..D).any(|a| cell[a] + 1 >= shape[a])
                        || settled(bernstein_bounds::<D>(&self.values[at..]))
                    {
                        continue;
                    }
                    out.push(cell.map(|x| x as u32));
                }
            }
        }
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
                let target = &mut self.values[to..];
                match (fill, part[D - 1][2]) {
                    (Err(value), length) => target[..length].fill(value),
                    // Copies of a fixed length are cheap.
                    (Ok(base), 2) => copy::<2>(&blocks.values()[base + from..], target),
                    (Ok(base), 3) => copy::<3>(&blocks.values()[base + from..], target),
                    (Ok(base), _) => copy::<SIDE>(&blocks.values()[base + from..], target),
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

    /// Replace the first `count` entries of each line, ascending, by a function of `N` entries from themselves on.
    #[inline(always)]
    fn map<const N: usize>(&self, values: &mut [f64], count: usize, new: impl Fn([f64; N]) -> f64) {
        let s = self.stride;
        for chunk in values.chunks_exact_mut(s * SPAN) {
            if s == 1 {
                for k in 0..count {
                    chunk[k] = new(std::array::from_fn(|q| chunk[k + q]));
                }
                continue;
            }
            for k in 0..count {
                // Rows side by side, so that they are worked on several entries at once.
                let (own, later) = chunk[k * s..(k + N) * s].split_at_mut(s);
                for (inner, v) in own.iter_mut().enumerate() {
                    *v = new(std::array::from_fn(|q| {
                        if q == 0 {
                            *v
                        } else {
                            later[(q - 1) * s + inner]
                        }
                    }));
                }
            }
        }
    }
}

/// Visit the entries of a window whose places along all axes are below `count`, in C order.
#[inline(always)]
fn each<const D: usize>(count: usize, mut visit: impl FnMut(usize)) {
    let planes = if D == 3 { count } else { 1 };
    for i in 0..planes {
        for j in 0..count {
            let row = (i * SPAN + j) * SPAN;
            for k in 0..count {
                visit(row + k);
            }
        }
    }
}

/// Least and largest value, several at once.
#[inline(always)]
fn range(values: &[f64]) -> [f64; 2] {
    let (mut low, mut high) = ([f64::INFINITY; 8], [f64::NEG_INFINITY; 8]);
    let mut widen = |k: usize, v: f64| {
        low[k] = if v < low[k] { v } else { low[k] };
        high[k] = if v > high[k] { v } else { high[k] };
    };
    let eights = values.chunks_exact(8);
    for (k, &v) in eights.remainder().iter().enumerate() {
        widen(k, v);
    }
    for eight in eights {
        for k in 0..8 {
            widen(k, eight[k]);
        }
    }
    [
        low.into_iter().fold(f64::INFINITY, f64::min),
        high.into_iter().fold(f64::NEG_INFINITY, f64::max),
    ]
}

#[inline(always)]
fn copy<const N: usize>(from: &[f64], to: &mut [f64]) {
    to[..N].copy_from_slice(&from[..N]);
}

/// Least and largest Bernstein coefficient on the cell whose first B-spline coefficient is the first of a window: bounds of
/// the interpolant there, much tighter than those of the B-spline coefficients.
#[inline(always)]
fn bernstein_bounds<const D: usize>(window: &[f64]) -> [f64; 2] {
    let mut b = [0.0; 64];
    let planes = if D == 3 { AROUND } else { 1 };
    for i in 0..planes {
        for j in 0..AROUND {
            let (from, to) = ((i * SPAN + j) * SPAN, (i * AROUND + j) * AROUND);
            b[to..to + AROUND].copy_from_slice(&window[from..from + AROUND]);
        }
    }
    for a in 0..D {
        let s = AROUND.pow((D - 1 - a) as u32);
        for line in 0..AROUND.pow(D as u32 - 1) {
            let at = line / s * s * AROUND + line % s;
            let [c0, c1, c2, c3] = [b[at], b[at + s], b[at + 2 * s], b[at + 3 * s]];
            let (p, q) = ((2.0 * c1 + c2) * (1.0 / 3.0), (c1 + 2.0 * c2) * (1.0 / 3.0));
            b[at] = 0.5 * ((c0 + 2.0 * c1) * (1.0 / 3.0) + p);
            b[at + s] = p;
            b[at + 2 * s] = q;
            b[at + 3 * s] = 0.5 * (q + (2.0 * c2 + c3) * (1.0 / 3.0));
        }
    }
    let b = &b[..AROUND.pow(D as u32)];
    b.iter()
        .fold([f64::INFINITY, f64::NEG_INFINITY], |[low, high], &v| {
            [if v < low { v } else { low }, if v > high { v } else { high }]
        })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Blobs of random places and widths, dense and in a band, on grids that end within a block.
    #[test]
    fn blocks_that_are_passed_over_have_no_live_cell() {
        let shape = [41, 64, 35];
        let mut state = 7_u64;
        let mut random = || {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
            (state >> 33) as f64 / (1_u64 << 31) as f64
        };
        let mut skipped = 0;
        for trial in 0..12 {
            let balls: Vec<([f64; 3], f64)> = (0..3)
                .map(|_| (shape.map(|n| n as f64 * random()), 2.0 + 9.0 * random()))
                .collect();
            let roughness = if trial % 3 == 0 { 2.0 } else { 0.0 };
            let dense: Vec<f64> = (0..shape.iter().product::<usize>())
                .map(|k| {
                    let node = [k / (64 * 35), k / 35 % 64, k % 35];
                    let distance = |(centre, radius): &([f64; 3], f64)| {
                        let square: f64 = (0..3).map(|a| (node[a] as f64 - centre[a]).powi(2)).sum();
                        square.sqrt() - radius
                    };
                    let least = balls.iter().map(distance).fold(f64::INFINITY, f64::min);
                    let sign = if trial % 2 == 0 { 1.0 } else { -1.0 };
                    sign * least + roughness * (random() - 0.5)
                })
                .collect();
            for far in [f64::INFINITY, 6.0] {
                let blocks = Blocks::from_dense(shape, &dense, far).unwrap();
                let all: Vec<([i64; 3], f64)> = candidates(&blocks)
                    .into_iter()
                    .map(|place| (place, f64::INFINITY))
                    .collect();
                let mut expected = Vec::new();
                cells_of(&blocks, &all, 1e-9, &mut expected);
                assert_eq!(live(&blocks, 1e-9), expected);
                let left = Screen::new(&blocks).crossed(&candidates(&blocks), 1e-9);
                skipped += all.len() - left.len();
            }
        }
        assert!(skipped > 100, "{skipped} blocks were passed over");
    }
}
