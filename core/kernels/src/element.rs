//! Elements: leaves cut at every active function's knots, so that on each one every basis function is one polynomial.

use std::sync::atomic::{AtomicU64, AtomicU8, Ordering};
use std::sync::Arc;

use rayon::prelude::*;
use rustc_hash::FxHashMap;

use crate::active::{for_each_leaf, Support};
use crate::bspline::{Cubic, PieceTable};
use crate::error::{KernelError, Result};
use crate::local::Local;
use crate::part::Part;
use crate::tree::{unit_cell, Tree, SIDE};

/// Factors are kept for planar meshes and for meshes with this many at most; beyond, memory would be mostly factors, and
/// an element's are made again when it is loaded.
const MAX_KEPT: usize = 1 << 22;

/// Elements in one unit of parallel work.
const CHUNK: usize = 1024;

/// A basis function on an element: its number and, for each axis, which of the element's pieces it uses. An element's
/// factors are sorted by their pieces, the last axis first.
#[derive(Debug, Clone, Copy)]
pub struct Factor<const D: usize> {
    pub function: u32,
    pub piece: [u8; D],
}

/// Where an element lies, in the unit box.
#[derive(Debug, Clone, Copy)]
pub struct Head<const D: usize> {
    /// Lower corner and inverse sides.
    pub corner: [f64; D],
    pub inverse: [f64; D],
}

/// All elements of a T-mesh, in the order of their leaves.
#[derive(Debug, Clone)]
pub struct Elements<const D: usize> {
    /// Tells the elements of different meshes apart; copies share it.
    id: u64,
    /// Lower and upper corner in tree units, and leaf.
    boxes: Vec<[[u32; D]; 2]>,
    leaf: Vec<u32>,
    /// First element of each leaf, one more at the end.
    first: Vec<u32>,
    /// Interior breaks of each leaf and axis: entry `D * leaf + axis`, one more at the end.
    break_start: Vec<u32>,
    breaks: Vec<u32>,
    /// Functions whose open support meets each leaf, ascending.
    active_start: Vec<usize>,
    active: Vec<u32>,
    /// Univariate knots of each function, by number, and the different ones.
    lines: Vec<[u32; D]>,
    knots: Vec<[u32; 5]>,
    /// The cubic of univariate knots on an interval: `[knots, low, high]`.
    spans: FxHashMap<[u32; 3], u32>,
    table: Vec<Cubic>,
    /// Whether the B_i add up to 1 all over an element: 0 as long as nobody asked, 1 no, 2 yes.
    unity: Arc<[AtomicU8]>,
    kept: Option<Kept<D>>,
    max_factors: usize,
}

/// What `Local` makes of each element.
#[derive(Debug, Clone)]
struct Kept<const D: usize> {
    /// Ends of each element's factors, and of its pieces along each axis.
    ends: Vec<(u32, [u32; D])>,
    factors: Vec<Factor<D>>,
    pieces: Vec<u32>,
}

impl<const D: usize> Elements<D> {
    pub(crate) fn new(tree: &Tree<D>, functions: &[[[u32; 5]; D]]) -> Result<Self> {
        static NEXT: AtomicU64 = AtomicU64::new(0);
        let mut e = Self {
            id: NEXT.fetch_add(1, Ordering::Relaxed),
            boxes: Vec::new(),
            leaf: Vec::new(),
            first: vec![0],
            break_start: vec![0],
            breaks: Vec::new(),
            active_start: vec![0],
            active: Vec::new(),
            lines: Vec::with_capacity(functions.len()),
            knots: Vec::new(),
            spans: FxHashMap::default(),
            table: Vec::new(),
            unity: Arc::new([]),
            kept: None,
            max_factors: 0,
        };
        let mut numbers: FxHashMap<[u32; 5], u32> = FxHashMap::default();
        for k in functions {
            e.lines.push(k.map(|axis| {
                *numbers.entry(axis).or_insert_with(|| {
                    e.knots.push(axis);
                    e.knots.len() as u32 - 1
                })
            }));
        }
        let supports: Vec<Support<D>> = functions
            .iter()
            .map(|k| [k.map(|axis| axis[0]), k.map(|axis| axis[4])])
            .collect();
        let parts = for_each_leaf(
            tree,
            &supports,
            || Part::new(e.knots.len()),
            |part, leaf, list| {
                let cell = tree.leaves()[leaf];
                let ends = [cell.corner, cell.corner.map(|x| x + cell.side())];
                part.leaf(leaf as u32, ends, list, &e.lines, &e.knots);
            },
        );
        e.collect(parts)?;
        let products: usize = (0..tree.leaves().len())
            .map(|k| e.active(k).len() * e.of_leaf(k).len())
            .sum();
        e.unity = (0..e.boxes.len()).map(|_| AtomicU8::new(0)).collect();
        if D == 2 || products <= MAX_KEPT {
            let kept = Kept::new(&e)?;
            e.kept = Some(kept);
        }
        Ok(e)
    }

    fn collect(&mut self, mut parts: Vec<Part<D>>) -> Result<()> {
        parts.iter_mut().for_each(Part::finish);
        let elements = parts.iter().map(|p| p.boxes.len()).sum();
        self.active
            .reserve_exact(parts.iter().map(|p| p.active.len()).sum());
        self.boxes.reserve_exact(elements);
        self.leaf.reserve_exact(elements);
        let mut table = PieceTable::default();
        for part in parts {
            if part.most_pieces > 256 {
                return Err(KernelError::TooLarge(
                    "more than 256 different univariate pieces on one leaf".into(),
                ));
            }
            for (elements, breaks, active) in part.counts {
                let leaf = self.first.len() as u32 - 1;
                self.leaf.extend((0..elements).map(|_| leaf));
                self.first.push(self.leaf.len() as u32);
                for count in breaks {
                    self.break_start
                        .push(self.break_start[self.break_start.len() - 1] + count);
                }
                self.active_start
                    .push(self.active_start[self.active_start.len() - 1] + active as usize);
                self.max_factors = self.max_factors.max(active as usize);
            }
            self.boxes.extend(part.boxes);
            self.breaks.extend(part.breaks);
            self.active.extend(part.active);
            for span in part.spans {
                let [line, low, high] = span;
                self.spans.entry(span).or_insert_with(|| {
                    let knots = self.knots[line as usize].map(i64::from);
                    table.entry(knots, i64::from(low), i64::from(high))
                });
            }
        }
        self.table = table.pieces().to_vec();
        Ok(())
    }

    /// Number of elements.
    pub fn len(&self) -> usize {
        self.boxes.len()
    }

    pub fn is_empty(&self) -> bool {
        self.boxes.is_empty()
    }

    /// No element has more basis functions.
    pub fn max_factors(&self) -> usize {
        self.max_factors
    }

    /// Leaf of an element.
    pub fn leaf(&self, element: usize) -> usize {
        self.leaf[element] as usize
    }

    /// Elements of a leaf.
    pub fn of_leaf(&self, leaf: usize) -> std::ops::Range<usize> {
        self.first[leaf] as usize..self.first[leaf + 1] as usize
    }

    /// Basis functions on a leaf, that is on some of its elements, ascending.
    #[inline]
    pub fn active(&self, leaf: usize) -> &[u32] {
        &self.active[self.active_start[leaf]..self.active_start[leaf + 1]]
    }

    /// The basis functions of every element, in the order of its factors: row starts and numbers.
    pub fn functions(&self) -> (Vec<usize>, Vec<u32>) {
        let chunks = self.per_chunk(|local, (counts, functions): &mut (Vec<usize>, Vec<u32>)| {
            counts.push(local.factors().len());
            functions.extend(local.factors().iter().map(|f| f.function));
        });
        let mut start = Vec::with_capacity(self.len() + 1);
        let mut all = Vec::with_capacity(chunks.iter().map(|c| c.1.len()).sum());
        let mut end = 0;
        start.push(0);
        for (counts, functions) in chunks {
            for n in counts {
                end += n;
                start.push(end);
            }
            all.extend(functions);
        }
        (start, all)
    }

    /// `take` every element, loaded, into the result of its chunk.
    fn per_chunk<T: Send + Default>(&self, take: impl Fn(&Local<D>, &mut T) + Sync) -> Vec<T> {
        (0..self.len().div_ceil(CHUNK))
            .into_par_iter()
            .map_init(Local::new, |local, chunk| {
                let mut out = T::default();
                for e in chunk * CHUNK..((chunk + 1) * CHUNK).min(self.len()) {
                    local.load(self, e);
                    take(local, &mut out);
                }
                out
            })
            .collect()
    }

    /// Where an element lies.
    #[inline]
    pub fn head(&self, element: usize) -> Head<D> {
        let [lo, hi] = self.boxes[element];
        let unit = 1.0 / f64::from(SIDE);
        Head {
            corner: lo.map(|x| f64::from(x) * unit),
            inverse: std::array::from_fn(|a| f64::from(SIDE) / f64::from(hi[a] - lo[a])),
        }
    }

    /// Lower corner and sides in the unit box.
    #[inline]
    pub fn frame(&self, element: usize) -> ([f64; D], [f64; D]) {
        let head = self.head(element);
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

    pub(crate) fn id(&self) -> u64 {
        self.id
    }

    /// Lower and upper corner in tree units.
    pub(crate) fn ends(&self, element: usize) -> [[u32; D]; 2] {
        self.boxes[element]
    }

    /// Numbers of a function's univariate knots.
    #[inline]
    pub(crate) fn lines(&self, function: u32) -> &[u32; D] {
        &self.lines[function as usize]
    }

    /// The different univariate knots.
    pub(crate) fn line_knots(&self) -> &[[u32; 5]] {
        &self.knots
    }

    /// Entry of the cubic of univariate knots on an element's extent along an axis.
    #[inline]
    pub(crate) fn entry(&self, line: u32, low: u32, high: u32) -> u32 {
        self.spans[&[line, low, high]]
    }

    pub(crate) fn cubic(&self, entry: u32) -> &Cubic {
        &self.table[entry as usize]
    }

    /// Whether the B_i add up to 1 all over an element; `find` is asked once at most, but for threads that ask together.
    pub(crate) fn unity(&self, element: usize, find: impl FnOnce() -> bool) -> bool {
        let known = &self.unity[element];
        match known.load(Ordering::Relaxed) {
            0 => {
                let unity = find();
                known.store(1 + u8::from(unity), Ordering::Relaxed);
                unity
            }
            state => state == 2,
        }
    }

    /// Factors of an element and the entries of its pieces along each axis, if they are kept.
    pub(crate) fn kept(&self, element: usize) -> Option<(&[Factor<D>], [&[u32]; D])> {
        let kept = self.kept.as_ref()?;
        let (mut factor, mut piece) = (0, 0);
        if element > 0 {
            let before = &kept.ends[element - 1];
            (factor, piece) = (before.0 as usize, before.1[D - 1] as usize);
        }
        let (end, ends) = &kept.ends[element];
        let pieces = ends.map(|end| {
            let axis = &kept.pieces[piece..end as usize];
            piece = end as usize;
            axis
        });
        Some((&kept.factors[factor..*end as usize], pieces))
    }
}

impl<const D: usize> Kept<D> {
    fn new(elements: &Elements<D>) -> Result<Self> {
        type Chunk<const D: usize> = (Vec<(u32, [u32; D])>, Vec<Factor<D>>, Vec<u32>);
        let chunks = elements.per_chunk(|local, (ends, factors, pieces): &mut Chunk<D>| {
            factors.extend_from_slice(local.factors());
            let piece_ends = std::array::from_fn(|a| {
                pieces.extend_from_slice(local.entries(a));
                pieces.len() as u32
            });
            ends.push((factors.len() as u32, piece_ends));
        });
        let total = chunks.iter().map(|c| c.1.len()).sum();
        if u32::try_from(total).is_err() {
            return Err(KernelError::TooLarge(
                "more than 2^32 basis functions on elements".into(),
            ));
        }
        let mut kept = Self {
            ends: Vec::with_capacity(elements.len()),
            factors: Vec::with_capacity(total),
            pieces: Vec::with_capacity(chunks.iter().map(|c| c.2.len()).sum()),
        };
        for (ends, factors, pieces) in chunks {
            let (factor, piece) = (kept.factors.len() as u32, kept.pieces.len() as u32);
            kept.ends
                .extend(ends.into_iter().map(|(f, p)| (f + factor, p.map(|p| p + piece))));
            kept.factors.extend(factors);
            kept.pieces.extend(pieces);
        }
        Ok(kept)
    }
}
