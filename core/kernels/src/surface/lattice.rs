//! A sparse lattice of cubes in bricks of 4 x 4 x 4: node values, signs and cases as bit masks.

use rustc_hash::FxHashMap;

use super::table::{table, NONE};

/// Cubes and nodes of one brick; entry `x + 4 y + 16 z`, bit likewise. A node belongs to the brick of the cube whose
/// lower corner it is.
#[derive(Clone)]
pub struct Brick {
    /// Lower corner in lattice units.
    pub corner: [i32; 3],
    pub values: [f64; 64],
    /// Nodes with a value, and those of them that are inside.
    pub known: u64,
    pub inside: u64,
    /// Cubes to look at, those that the surface passes, those with turned loops.
    pub live: u64,
    pub active: u64,
    pub turned: u64,
    pub cases: [u8; 64],
    /// First vertex of each active cube.
    pub first: [u32; 64],
}

/// Bricks by their place. Cubes and nodes are numbered from 0 to n along each axis; the layers -1 and n of cubes lie outside the
/// box and their outer nodes count as outside, which closes the surface along the box.
pub struct Lattice {
    pub n: [i32; 3],
    /// Sides of a cube.
    pub side: [f64; 3],
    pub bricks: Vec<Brick>,
    index: FxHashMap<[i32; 3], u32>,
}

/// Bits of a brick whose place along axis a is `at`.
const fn slab(a: u32, at: u32) -> u64 {
    let mut mask = 0;
    let mut k = 0;
    while k < 64 {
        if (k >> (2 * a)) & 3 == at {
            mask |= 1 << k;
        }
        k += 1;
    }
    mask
}

const LAST: [u64; 3] = [slab(0, 3), slab(1, 3), slab(2, 3)];
const FIRST: [u64; 3] = [slab(0, 0), slab(1, 0), slab(2, 0)];

/// Bits one step up along an axis: those that stay in the brick, and those that enter the next one.
#[inline]
fn raise(mask: u64, a: usize) -> [u64; 2] {
    [
        (mask & !LAST[a]) << (1 << (2 * a)),
        (mask & LAST[a]) >> (3 << (2 * a)),
    ]
}

/// Bits one step down along an axis, those of the next brick up flowing in.
#[inline]
fn lower(own: u64, next: u64, a: usize) -> u64 {
    ((own & !FIRST[a]) >> (1 << (2 * a))) | ((next & FIRST[a]) << (3 << (2 * a)))
}

#[inline]
pub fn bit_of(p: [i32; 3]) -> usize {
    ((p[0] & 3) | (p[1] & 3) << 2 | (p[2] & 3) << 4) as usize
}

/// Lattice place of a brick's k-th cube or node.
#[inline]
pub fn place(corner: [i32; 3], k: usize) -> [i32; 3] {
    std::array::from_fn(|a| corner[a] + (k >> (2 * a) & 3) as i32)
}

/// The bits that are set, ascending.
pub fn bits(mut mask: u64) -> impl Iterator<Item = usize> {
    std::iter::from_fn(move || {
        (mask != 0).then(|| {
            let k = mask.trailing_zeros() as usize;
            mask &= mask - 1;
            k
        })
    })
}

impl Lattice {
    /// `n` cubes along each axis with the given sides, none of them live.
    pub fn new(n: [i32; 3], side: [f64; 3]) -> Self {
        Self {
            n,
            side,
            bricks: Vec::new(),
            index: FxHashMap::default(),
        }
    }

    #[inline]
    fn corner_of(p: [i32; 3]) -> [i32; 3] {
        p.map(|x| x & !3)
    }

    /// Number of the brick that holds a cube or node.
    #[inline]
    pub fn find(&self, p: [i32; 3]) -> Option<usize> {
        self.index.get(&Self::corner_of(p)).map(|&b| b as usize)
    }

    /// As `find`, made when it is new. `last` is the caller's memory of the brick before: neighbours come one after another.
    #[inline]
    pub fn brick(&mut self, p: [i32; 3], last: &mut usize) -> &mut Brick {
        let corner = Self::corner_of(p);
        if self.bricks.get(*last).is_none_or(|b| b.corner != corner) {
            let bricks = &mut self.bricks;
            *last = *self.index.entry(corner).or_insert_with(|| {
                bricks.push(Brick {
                    corner,
                    values: [0.0; 64],
                    known: 0,
                    inside: 0,
                    live: 0,
                    active: 0,
                    turned: 0,
                    cases: [0; 64],
                    first: [0; 64],
                });
                (bricks.len() - 1) as u32
            }) as usize;
        }
        &mut self.bricks[*last]
    }

    /// Give a node its value unless it has one.
    #[inline]
    pub fn set(&mut self, p: [i32; 3], value: f64, last: &mut usize) {
        let brick = self.brick(p, last);
        let k = bit_of(p);
        if brick.known >> k & 1 == 0 {
            brick.known |= 1 << k;
            brick.values[k] = value;
        }
    }

    /// Look at a cube.
    #[inline]
    pub fn enliven(&mut self, p: [i32; 3], last: &mut usize) {
        self.brick(p, last).live |= 1 << bit_of(p);
    }

    /// Bricks at the upper (`sign` 1) or lower (-1) side along the axes of each subset, itself for the empty one.
    pub fn around(&self, b: usize, sign: i32) -> [Option<usize>; 8] {
        let corner = self.bricks[b].corner;
        std::array::from_fn(|subset| {
            if subset == 0 {
                return Some(b);
            }
            self.find(std::array::from_fn(|a| {
                corner[a] + 4 * sign * (subset >> a & 1) as i32
            }))
        })
    }

    /// Nodes of live cubes that have no value yet; they are marked as known, values to follow.
    pub fn missing(&mut self) -> Vec<[i32; 3]> {
        let mut out = Vec::new();
        for b in 0..self.bricks.len() {
            let (corner, live) = (self.bricks[b].corner, self.bricks[b].live);
            // All corners of the live cubes, by the brick that they fall into.
            let mut needed = [0_u64; 8];
            needed[0] = live;
            for a in 0..3 {
                for subset in 0..1 << a {
                    let [stay, leave] = raise(needed[subset], a);
                    needed[subset] |= stay;
                    needed[subset | 1 << a] |= leave;
                }
            }
            let mut last = b;
            for subset in 0..8 {
                if needed[subset] == 0 {
                    continue;
                }
                let at = std::array::from_fn(|a| corner[a] + 4 * (subset >> a & 1) as i32);
                let brick = self.brick(at, &mut last);
                let new = needed[subset] & !brick.known;
                brick.known |= new;
                out.extend(bits(new).map(|k| place(at, k)));
            }
        }
        out
    }

    /// Replace a node's value.
    pub fn put(&mut self, p: [i32; 3], value: f64, last: &mut usize) {
        self.brick(p, last).values[bit_of(p)] = value;
    }

    /// Classify nodes (`f < -zero` is inside) and cubes, close the surface along the box, number the vertices; returns
    /// how many there are.
    pub fn classify(&mut self, zero: f64) -> usize {
        for brick in &mut self.bricks {
            brick.inside = bits(brick.known)
                .filter(|&k| brick.values[k] < -zero)
                .fold(0, |m, k| m | 1 << k);
        }
        self.close();
        for b in 0..self.bricks.len() {
            self.find_cases(b);
        }
        self.turn();
        let mut count = 0;
        for brick in &mut self.bricks {
            for k in bits(brick.active) {
                brick.first[k] = count;
                count += u32::from(table().patches(brick.cases[k], brick.turned >> k & 1 == 1).count);
            }
        }
        count as usize
    }

    /// Cubes outside the box at the live ones along its faces, edges and corners.
    fn close(&mut self) {
        let n = self.n;
        let mut outer = Vec::new();
        for brick in &self.bricks {
            if (0..3).all(|a| brick.corner[a] > 0 && brick.corner[a] + 4 < n[a]) {
                continue;
            }
            for k in bits(brick.live) {
                let p = place(brick.corner, k);
                for direction in 1..27 {
                    let step = [direction % 3, direction / 3 % 3, direction / 9];
                    let q: [i32; 3] = std::array::from_fn(|a| p[a] + [0, -1, 1][step[a]]);
                    if (0..3).all(|a| step[a] == 0 || q[a] < 0 || q[a] >= n[a]) {
                        outer.push(q);
                    }
                }
            }
        }
        let mut last = usize::MAX;
        for q in outer {
            self.enliven(q, &mut last);
        }
    }

    fn find_cases(&mut self, b: usize) {
        let live = self.bricks[b].live;
        if live == 0 {
            return;
        }
        let inside = self
            .around(b, 1)
            .map(|other| other.map_or(0, |k| self.bricks[k].inside));
        // corner[k]: the cubes whose corner k is inside.
        let mut corner = [0_u64; 8];
        for (k, mask) in corner.iter_mut().enumerate() {
            let mut part = inside;
            for a in (0..3).filter(|a| k >> a & 1 == 1) {
                for subset in (0..8).filter(|s| s >> a & 1 == 0) {
                    part[subset] = lower(part[subset], part[subset | 1 << a], a);
                }
            }
            *mask = part[0];
        }
        let any = corner.iter().fold(0, |m, c| m | c);
        let all = corner.iter().fold(u64::MAX, |m, c| m & c);
        let brick = &mut self.bricks[b];
        brick.active = live & any & !all;
        for k in bits(brick.active) {
            brick.cases[k] = (0..8).fold(0, |case, c| case | ((corner[c] >> k & 1) as u8) << c);
        }
    }

    /// Turn the loops of cubes that would pinch the surface between them.
    fn turn(&mut self) {
        for b in 0..self.bricks.len() {
            for k in bits(self.bricks[b].active) {
                let face = table().pinched(self.bricks[b].cases[k]);
                if face == NONE {
                    continue;
                }
                let mut p = place(self.bricks[b].corner, k);
                p[usize::from(face / 2)] += if face % 2 == 0 { -1 } else { 1 };
                let other = self.find(p).map(|o| &self.bricks[o]);
                let same = other.is_some_and(|o| {
                    o.active >> bit_of(p) & 1 == 1 && table().pinched(o.cases[bit_of(p)]) == face ^ 1
                });
                if same {
                    self.bricks[b].turned |= 1 << k;
                }
            }
        }
    }
}
