//! Where a T-spline in space may vanish: the cubes of a lattice that are worth a look.
//!
//! What is left out has one sign on its whole closure, provably: either all coefficients that act there have it (the basis
//! is positive), or all Bernstein coefficients of the numerator; or it is a single cube whose corners have one sign, which
//! is all that the lattice sees of it. All ask for a margin far above rounding, so that a node evaluated from the other side
//! of a face cannot have the other sign.

use std::sync::atomic::{AtomicUsize, Ordering};

use rayon::prelude::*;

use super::hull::{bernstein, bounds, corners, halves, thirds, Patch};
use crate::element::Elements;
use crate::error::{KernelError, Result};
use crate::mesh::TMesh;
use crate::polynomial::Quotient;
use crate::tree::{Leaf, MAX_LEVEL, SIDE};

/// Leaves in one unit of parallel work.
const CHUNK: usize = 256;
/// Cubes beyond this number are refused: the surface alone would take gigabytes.
const MAX_CUBES: usize = 1 << 24;

/// Where the field may vanish, and how small a number must be to count as zero.
pub struct Signs<'a> {
    pub mesh: &'a TMesh<3>,
    pub c: &'a [f64],
    /// For each leaf +1 or -1 if the field has this sign on it, else 0. Leaves that are inside and touch the box's border
    /// have 0: the surface is closed there.
    pub of_leaf: Vec<i8>,
    /// Bounds of one sign are trusted beyond this.
    margin: f64,
}

/// A cube, by its place in the lattice, with the numerator at its corners; NaN where that is not known yet.
#[derive(Clone, Copy)]
pub struct Cube {
    pub at: [i32; 3],
    pub values: [f64; 8],
}

/// Cubes to look at.
#[derive(Default)]
pub struct Live {
    /// Leaves that are cubes themselves: only the lower corner's value comes with them.
    pub leaves: Vec<([i32; 3], f64)>,
    pub cubes: Vec<Cube>,
}

impl<'a> Signs<'a> {
    pub fn new(mesh: &'a TMesh<3>, c: &'a [f64], margin: f64) -> Self {
        let elements = mesh.elements();
        // Bit 0: not surely positive; bit 1: not surely negative. A byte a function keeps the table in the cache.
        let doubts: Vec<u8> = c
            .iter()
            .map(|&v| u8::from(v <= margin) | u8::from(v >= -margin) << 1)
            .collect();
        let of_leaf = (0..mesh.num_cells())
            .into_par_iter()
            .with_min_len(CHUNK)
            .map(|leaf| {
                let doubt = doubt_of(elements.active(leaf), &doubts);
                match doubt {
                    2 => 1,
                    1 if !on_border(&mesh.tree().leaves()[leaf]) => -1,
                    _ => 0,
                }
            })
            .collect();
        Self {
            mesh,
            c,
            of_leaf,
            margin,
        }
    }

    /// The level of the smallest leaves that the zero set visits, of the smallest at the border where the shape is cut if it
    /// visits none; `None` if nothing is inside.
    pub fn finest_level(&self) -> Option<u8> {
        let leaves = self.mesh.tree().leaves();
        let mut fallback = None;
        for level in (0..=self.mesh.depth()).rev() {
            let at_level: Vec<usize> = (0..leaves.len())
                .filter(|&k| self.of_leaf[k] == 0 && leaves[k].level == level)
                .collect();
            let visited = at_level.par_chunks(CHUNK).any(|some| {
                let mut quotient = Quotient::new();
                some.iter().any(|&k| {
                    self.mesh.elements().of_leaf(k).any(|e| {
                        let [least, largest] = bounds(&self.patch(&mut quotient, e));
                        least <= self.margin && largest >= -self.margin
                    })
                })
            });
            if visited {
                return Some(level);
            }
            if fallback.is_none() && !at_level.is_empty() {
                fallback = Some(level);
            }
        }
        fallback
    }

    /// Cubes of the lattice with `2^level` of them an axis in which the field may vanish.
    pub fn cubes(&self, level: u8) -> Result<Live> {
        let numbers: Vec<usize> = (0..self.of_leaf.len())
            .filter(|&k| self.of_leaf[k] == 0)
            .collect();
        let count = AtomicUsize::new(0);
        let parts: Vec<Result<Live>> = numbers
            .par_chunks(CHUNK)
            .map(|numbers| {
                let mut work = Work {
                    signs: self,
                    quotient: Quotient::new(),
                    level,
                    out: Live::default(),
                };
                for &k in numbers {
                    let before = work.out.cubes.len();
                    work.leaf(k)?;
                    let new = work.out.cubes.len() - before;
                    if count.fetch_add(new, Ordering::Relaxed) + new > MAX_CUBES {
                        return Err(too_many());
                    }
                }
                Ok(work.out)
            })
            .collect();
        let mut live = Live::default();
        for part in parts {
            let part = part?;
            live.leaves.extend_from_slice(&part.leaves);
            live.cubes.extend_from_slice(&part.cubes);
        }
        Ok(live)
    }

    fn patch(&self, quotient: &mut Quotient<3>, element: usize) -> Patch {
        quotient.load(self.mesh.elements(), element, self.c);
        bernstein(quotient.numerator())
    }
}

fn doubt_of(functions: &[u32], doubts: &[u8]) -> u8 {
    let mut doubt = 0;
    for some in functions.chunks(16) {
        doubt = some.iter().fold(doubt, |d, &i| d | doubts[i as usize]);
        if doubt == 3 {
            break;
        }
    }
    doubt
}

fn too_many() -> KernelError {
    KernelError::TooLarge(format!(
        "the zero set passes more than {MAX_CUBES} cubes: take a larger tolerance"
    ))
}

fn on_border(cell: &Leaf<3>) -> bool {
    cell.corner.iter().any(|&x| x == 0 || x + cell.side() == SIDE)
}

/// A box of cubes: lower corner and numbers of cubes.
#[derive(Clone, Copy)]
struct Block {
    at: [i32; 3],
    size: [i32; 3],
}

/// Work of one thread.
struct Work<'a> {
    signs: &'a Signs<'a>,
    quotient: Quotient<3>,
    level: u8,
    out: Live,
}

impl Work<'_> {
    fn leaf(&mut self, k: usize) -> Result<()> {
        let signs = self.signs;
        let (leaf, elements) = (signs.mesh.tree().leaves()[k], signs.mesh.elements());
        let shift = MAX_LEVEL - self.level;
        let at = leaf.corner.map(|x| (x >> shift) as i32);
        if leaf.level >= self.level {
            let first = elements.of_leaf(k).start;
            if leaf.level == self.level {
                let value = self.lower_corner(elements, first);
                self.out.leaves.push((at, value));
            } else if self.out.cubes.last().is_none_or(|last| last.at != at) {
                self.out.cubes.push(unknown(at));
            }
            return Ok(());
        }
        for e in elements.of_leaf(k) {
            let patch = signs.patch(&mut self.quotient, e);
            let (corner, side) = elements.frame(e);
            let cells = f64::from(1_u32 << self.level);
            let (low, size) = (corner.map(|x| x * cells), side.map(|x| x * cells));
            let whole = |x: f64| x >= 1.0 && x.fract() == 0.0;
            let fits = (0..3).all(|a| {
                low[a].fract() == 0.0 && whole(size[a].round()) && (size[a].round() as u32).is_power_of_two()
            }) && (0..3).all(|a| (size[a] - size[a].round()).abs() < 1e-9);
            if fits {
                let block = Block {
                    at: low.map(|x| x as i32),
                    size: size.map(|x| x.round() as i32),
                };
                self.mark(&patch, block)?;
            } else {
                // Knots cut across cubes, which happens in coarse leaves beside finer ones only.
                self.fill(&patch, low, size)?;
            }
        }
        Ok(())
    }

    /// N at the lower corner of an element: there all powers but the zeroth vanish.
    fn lower_corner(&mut self, elements: &Elements<3>, e: usize) -> f64 {
        let local = self.quotient.select(elements, e);
        let [x, y, z] = local.cubics();
        let (mut sum, mut line) = (0.0, 0.0);
        let mut last = [u8::MAX; 2];
        let mut scale = 0.0;
        // Factors that share their pieces along the later axes follow one another.
        for f in local.factors() {
            let key = [f.piece[1], f.piece[2]];
            if key != last {
                sum += scale * line;
                (line, last) = (0.0, key);
                scale = y[key[0] as usize][0] * z[key[1] as usize][0];
            }
            line += self.signs.c[f.function as usize] * x[f.piece[0] as usize][0];
        }
        sum + scale * line
    }

    /// Push the cubes of a block, halved until they are single, unless the patch has one sign on it.
    fn mark(&mut self, patch: &Patch, block: Block) -> Result<()> {
        if self.is_settled(patch, block) {
            return Ok(());
        }
        if block.size == [2; 3] {
            self.push_eight(patch, block.at);
            return self.check_count();
        }
        let axis = (0..3).max_by_key(|&a| (block.size[a], 3 - a)).unwrap_or(0);
        if block.size[axis] == 1 {
            self.out.cubes.push(Cube {
                at: block.at,
                values: corners(patch),
            });
            return self.check_count();
        }
        let mut half = block;
        half.size[axis] /= 2;
        for part in &halves(patch, axis) {
            self.mark(part, half)?;
            half.at[axis] += half.size[axis];
        }
        Ok(())
    }

    /// Push those of 2 x 2 x 2 cubes whose corners do not surely have one sign; at the box's border all of them.
    fn push_eight(&mut self, patch: &Patch, at: [i32; 3]) {
        let nodes = thirds(patch);
        let margin = self.signs.margin;
        let n = 1_i32 << self.level;
        let border = (0..3).any(|a| at[a] == 0 || at[a] + 2 == n);
        for k in 0..8 {
            let first = 9 * (k & 1) + 3 * (k >> 1 & 1) + (k >> 2);
            let values: [f64; 8] =
                std::array::from_fn(|c| nodes[first + 9 * (c & 1) + 3 * (c >> 1 & 1) + (c >> 2)]);
            let above = values.iter().all(|&v| v > margin);
            let below = values.iter().all(|&v| v < -margin);
            if border || !(above || below) {
                self.out.cubes.push(Cube {
                    at: std::array::from_fn(|a| at[a] + (k >> a & 1) as i32),
                    values,
                });
            }
        }
    }

    /// Push all cubes that meet an element.
    fn fill(&mut self, patch: &Patch, low: [f64; 3], size: [f64; 3]) -> Result<()> {
        let at = low.map(|x| x.floor() as i32);
        let end: [i32; 3] = std::array::from_fn(|a| (low[a] + size[a] - 1e-9).ceil() as i32);
        let block = Block {
            at,
            size: std::array::from_fn(|a| end[a] - at[a]),
        };
        if self.is_settled(patch, block) {
            return Ok(());
        }
        for z in at[2]..end[2] {
            for y in at[1]..end[1] {
                self.out.cubes.extend((at[0]..end[0]).map(|x| unknown([x, y, z])));
            }
            self.check_count()?;
        }
        Ok(())
    }

    /// Whether nothing of the surface passes a block: one sign, and not inside at the box's border.
    fn is_settled(&self, patch: &Patch, block: Block) -> bool {
        let [least, largest] = bounds(patch);
        let n = 1_i32 << self.level;
        let border = (0..3).any(|a| block.at[a] == 0 || block.at[a] + block.size[a] == n);
        least > self.signs.margin || (largest < -self.signs.margin && !border)
    }

    fn check_count(&self) -> Result<()> {
        if self.out.cubes.len() > MAX_CUBES {
            return Err(too_many());
        }
        Ok(())
    }
}

fn unknown(at: [i32; 3]) -> Cube {
    Cube {
        at,
        values: [f64::NAN; 8],
    }
}
