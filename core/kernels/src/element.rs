//! Elements: leaves cut at every active function's knots, so that on each one every basis function is one polynomial.

use crate::bspline::{Cubic, PieceTable};
use crate::error::{KernelError, Result};
use crate::polynomial::Quotient;
use crate::tree::{unit_cell, Tree, SIDE};

/// A basis function on an element: its number and, for each axis, which of the element's pieces it uses. An element's
/// factors are sorted by their pieces, the last axis first.
#[derive(Debug, Clone, Copy)]
pub struct Factor<const D: usize> {
    pub function: u32,
    pub piece: [u8; D],
}

/// A univariate piece of the element being made.
struct Piece {
    knots: [u32; 5],
    entry: u32,
}

/// What evaluation needs of an element, in one cache line.
#[derive(Debug, Clone, Copy)]
pub struct Head<const D: usize> {
    /// Lower corner and inverse sides, in the unit box.
    pub corner: [f64; D],
    pub inverse: [f64; D],
    /// First and last + 1 of its factors.
    factors: [u32; 2],
    /// Where its piece list starts, and where each axis's part of it ends.
    first_piece: u32,
    piece_end: [u32; D],
    leaf: u32,
    /// Whether the B_i add up to 1 all over the element, so that no division is needed.
    pub unity: bool,
}

/// All elements of a T-mesh, in the order of their leaves.
#[derive(Debug, Clone)]
pub struct Elements<const D: usize> {
    heads: Vec<Head<D>>,
    factors: Vec<Factor<D>>,
    piece_list: Vec<u32>,
    table: Vec<Cubic>,
    max_pieces: usize,
    max_factors: usize,
    /// First element of each leaf, one more at the end.
    first: Vec<u32>,
    /// Interior breaks of each leaf and axis: entry `D * leaf + axis`, one more at the end.
    break_start: Vec<u32>,
    breaks: Vec<u32>,
}

impl<const D: usize> Elements<D> {
    pub(crate) fn new(tree: &Tree<D>, knots: &[[[u32; 5]; D]]) -> Result<Self> {
        let (start, active) = active_functions(tree, knots);
        let leaves = tree.leaves();
        let mut e = Self {
            heads: Vec::with_capacity(leaves.len()),
            factors: Vec::with_capacity(active.len()),
            piece_list: Vec::new(),
            table: Vec::new(),
            max_pieces: 0,
            max_factors: 0,
            first: vec![0],
            break_start: vec![0],
            breaks: Vec::new(),
        };
        let mut table = PieceTable::default();
        let mut ends: [Vec<u32>; D] = std::array::from_fn(|_| Vec::new());
        let mut lists: [Vec<Piece>; D] = std::array::from_fn(|_| Vec::new());
        for (k, leaf) in leaves.iter().enumerate() {
            let mine = &active[start[k] as usize..start[k + 1] as usize];
            for (a, ends) in ends.iter_mut().enumerate() {
                let (lo, hi) = (leaf.corner[a], leaf.corner[a] + leaf.side());
                ends.clear();
                ends.extend([lo, hi]);
                // Only the knots that cut the leaf, which most leaves do not have.
                ends.extend(
                    mine.iter()
                        .flat_map(|&i| knots[i as usize][a])
                        .filter(|&x| lo < x && x < hi),
                );
                if ends.len() > 2 {
                    ends.sort_unstable();
                    ends.dedup();
                }
            }
            for axis in &ends {
                e.breaks.extend_from_slice(&axis[1..axis.len() - 1]);
                e.break_start.push(e.breaks.len() as u32);
            }
            let count: usize = ends.iter().map(|x| x.len() - 1).product();
            for sub in 0..count {
                let mut rest = sub;
                let (mut lo, mut hi) = ([0; D], [0; D]);
                for a in 0..D {
                    let i = rest % (ends[a].len() - 1);
                    rest /= ends[a].len() - 1;
                    (lo[a], hi[a]) = (ends[a][i], ends[a][i + 1]);
                }
                e.push(k as u32, lo, hi, mine, knots, &mut table, &mut lists)?;
            }
            e.first.push(e.heads.len() as u32);
        }
        e.table = table.pieces().to_vec();
        let mut sum = Quotient::new();
        for k in 0..e.heads.len() {
            e.heads[k].unity = sum.is_unity(&e, k);
        }
        Ok(e)
    }

    fn push(
        &mut self,
        leaf: u32,
        lo: [u32; D],
        hi: [u32; D],
        candidates: &[u32],
        knots: &[[[u32; 5]; D]],
        table: &mut PieceTable,
        lists: &mut [Vec<Piece>; D],
    ) -> Result<()> {
        lists.iter_mut().for_each(Vec::clear);
        let begin = self.factors.len();
        for &i in candidates {
            let k = &knots[i as usize];
            if (0..D).any(|a| k[a][0] >= hi[a] || k[a][4] <= lo[a]) {
                continue;
            }
            let mut piece = [0_u8; D];
            for a in 0..D {
                // Few functions on an element differ along one axis: the table is asked once for each.
                let at = lists[a].iter().position(|p| p.knots == k[a]).unwrap_or_else(|| {
                    let entry = table.entry(k[a].map(i64::from), i64::from(lo[a]), i64::from(hi[a]));
                    lists[a].push(Piece { knots: k[a], entry });
                    lists[a].len() - 1
                });
                piece[a] = u8::try_from(at).map_err(|_| {
                    KernelError::TooLarge("more than 256 different univariate pieces on one element".into())
                })?;
            }
            self.factors.push(Factor { function: i, piece });
        }
        // Sums over the factors then can be nested: along the first axis within the second within the third.
        self.factors[begin..]
            .sort_unstable_by_key(|f| f.piece.iter().rev().fold(0, |key, &p| key << 8 | u32::from(p)));
        self.max_factors = self.max_factors.max(self.factors.len() - begin);
        let end = u32::try_from(self.factors.len())
            .map_err(|_| KernelError::TooLarge("more than 2^32 basis functions on elements".into()))?;
        let first_piece = self.piece_list.len() as u32;
        let piece_end = std::array::from_fn(|a| {
            self.max_pieces = self.max_pieces.max(lists[a].len());
            self.piece_list.extend(lists[a].iter().map(|p| p.entry));
            self.piece_list.len() as u32
        });
        let unit = 1.0 / f64::from(SIDE);
        self.heads.push(Head {
            corner: lo.map(|x| f64::from(x) * unit),
            inverse: std::array::from_fn(|a| f64::from(SIDE) / f64::from(hi[a] - lo[a])),
            factors: [begin as u32, end],
            first_piece,
            piece_end,
            leaf,
            unity: false,
        });
        Ok(())
    }

    /// Number of elements.
    pub fn len(&self) -> usize {
        self.heads.len()
    }

    pub fn is_empty(&self) -> bool {
        self.heads.is_empty()
    }

    /// The most basis functions on one element.
    pub fn max_factors(&self) -> usize {
        self.max_factors
    }

    /// The most different pieces on one element and axis.
    pub fn max_pieces(&self) -> usize {
        self.max_pieces
    }

    /// Leaf of an element.
    pub fn leaf(&self, element: usize) -> usize {
        self.heads[element].leaf as usize
    }

    /// Elements of a leaf.
    pub fn of_leaf(&self, leaf: usize) -> std::ops::Range<usize> {
        self.first[leaf] as usize..self.first[leaf + 1] as usize
    }

    /// What evaluation needs of an element.
    #[inline]
    pub fn head(&self, element: usize) -> &Head<D> {
        &self.heads[element]
    }

    /// Basis functions on an element.
    #[inline]
    pub fn factors(&self, element: usize) -> &[Factor<D>] {
        &self.factors[self.factor_range(element)]
    }

    /// Range of an element's factors in the flat list of all elements.
    #[inline]
    pub fn factor_range(&self, element: usize) -> std::ops::Range<usize> {
        let [first, end] = self.heads[element].factors;
        first as usize..end as usize
    }

    /// The element's different cubics along an axis.
    #[inline]
    pub fn pieces(&self, element: usize, axis: usize) -> impl Iterator<Item = &Cubic> {
        let head = &self.heads[element];
        let first = if axis == 0 {
            head.first_piece
        } else {
            head.piece_end[axis - 1]
        };
        self.piece_list[first as usize..head.piece_end[axis] as usize]
            .iter()
            .map(|&k| &self.table[k as usize])
    }

    /// Lower corner and sides in the unit box.
    #[inline]
    pub fn frame(&self, element: usize) -> ([f64; D], [f64; D]) {
        let head = &self.heads[element];
        (head.corner, head.inverse.map(|x| 1.0 / x))
    }

    /// The element at a point of the unit box; `None` outside (and for NaN).
    #[inline]
    pub fn locate(&self, tree: &Tree<D>, x: &[f64; D]) -> Option<usize> {
        if !x.iter().all(|v| (0.0..=1.0).contains(v)) {
            return None;
        }
        let p = x.map(unit_cell);
        let leaf = tree.leaf_at(p);
        let first = self.first[leaf] as usize;
        if self.first[leaf + 1] as usize == first + 1 {
            return Some(first);
        }
        let (mut offset, mut stride) = (0, 1);
        for a in 0..D {
            let at = D * leaf + a;
            let breaks = &self.breaks[self.break_start[at] as usize..self.break_start[at + 1] as usize];
            offset += stride * breaks.iter().filter(|&&b| b <= p[a]).count();
            stride *= breaks.len() + 1;
        }
        Some(first + offset)
    }
}

/// For every leaf the functions whose open support meets it: row starts and function numbers, ascending.
fn active_functions<const D: usize>(tree: &Tree<D>, knots: &[[[u32; 5]; D]]) -> (Vec<u32>, Vec<u32>) {
    let mut start = vec![0_u32; tree.leaves().len() + 1];
    let mut met: Vec<u32> = Vec::with_capacity(24 * knots.len());
    let mut ends = Vec::with_capacity(knots.len());
    let mut stack = Vec::new();
    for k in knots {
        tree.for_each_overlap(k.map(|a| a[0]), k.map(|a| a[4]), &mut stack, |leaf| {
            start[leaf + 1] += 1;
            met.push(leaf as u32);
        });
        ends.push(met.len());
    }
    for k in 1..start.len() {
        start[k] += start[k - 1];
    }
    let mut fill = start.clone();
    let mut active = vec![0_u32; met.len()];
    let mut begin = 0;
    for (i, &end) in ends.iter().enumerate() {
        for &leaf in &met[begin..end] {
            let at = &mut fill[leaf as usize];
            active[*at as usize] = i as u32;
            *at += 1;
        }
        begin = end;
    }
    (start, active)
}
