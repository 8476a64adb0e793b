//! The basis functions on one element, made from those that act on its leaf.

use crate::bspline::Cubic;
use crate::element::{Elements, Factor, Head};
use crate::polynomial::{nested_sum, Tensor};

/// Room for the cubics of an element; 256 places an axis make every `u8` a valid index.
pub type Cubics<const D: usize> = [[Cubic; 256]; D];

/// States of univariate knots while an element is made; below, the number of their piece.
const UNSEEN: u16 = u16::MAX;
const MISSES: u16 = u16::MAX - 1;
const MEETS: u16 = u16::MAX - 2;

/// More combinations of pieces than this are sorted rather than counted.
const MAX_COUNTED: usize = 1 << 16;

/// Basis functions and pieces of one element. Made once a thread and loaded element by element.
pub struct Local<const D: usize> {
    /// What is loaded: elements and number.
    loaded: Option<(u64, usize)>,
    head: Head<D>,
    unity: bool,
    factors: Vec<Factor<D>>,
    /// Table entries of the pieces along each axis, and their cubics.
    entries: [Vec<u32>; D],
    cubics: Box<Cubics<D>>,
    /// Work space: states of univariate knots, those that are not `UNSEEN`, and the factors by combination of pieces.
    states: [Vec<u16>; D],
    touched: [Vec<u32>; D],
    unsorted: Vec<Factor<D>>,
    place: Vec<Factor<D>>,
    taken: Vec<u64>,
}

impl<const D: usize> Default for Local<D> {
    fn default() -> Self {
        Self::new()
    }
}

impl<const D: usize> Local<D> {
    /// No element.
    pub fn new() -> Self {
        Self {
            loaded: None,
            head: Head {
                corner: [0.0; D],
                inverse: [1.0; D],
            },
            unity: true,
            factors: Vec::new(),
            entries: std::array::from_fn(|_| Vec::new()),
            cubics: Box::new([[[0.0; 4]; 256]; D]),
            states: std::array::from_fn(|_| Vec::new()),
            touched: std::array::from_fn(|_| Vec::new()),
            unsorted: Vec::new(),
            place: Vec::new(),
            taken: Vec::new(),
        }
    }

    /// Take an element; nothing is done if it is the one that is loaded.
    #[inline]
    pub fn load(&mut self, elements: &Elements<D>, element: usize) {
        let wanted = Some((elements.id(), element));
        if self.loaded != wanted {
            self.fill(elements, element);
            self.loaded = wanted;
        }
    }

    fn fill(&mut self, elements: &Elements<D>, element: usize) {
        self.head = elements.head(element);
        if let Some((factors, pieces)) = elements.kept(element) {
            self.factors.clear();
            self.factors.extend_from_slice(factors);
            for (mine, entries) in self.entries.iter_mut().zip(pieces) {
                mine.clear();
                mine.extend_from_slice(entries);
            }
        } else {
            self.find(elements, element);
            self.sort();
        }
        for (axis, entries) in self.cubics.iter_mut().zip(&self.entries) {
            for (slot, &entry) in axis.iter_mut().zip(entries) {
                *slot = *elements.cubic(entry);
            }
        }
        self.unity = elements.unity(element, || self.is_unity());
    }

    /// The functions of the leaf that meet the element; pieces are numbered in the order in which they come up.
    fn find(&mut self, elements: &Elements<D>, element: usize) {
        let [low, high] = elements.ends(element);
        let knots = elements.line_knots();
        for states in &mut self.states {
            if states.len() < knots.len() {
                states.resize(knots.len(), UNSEEN);
            }
        }
        self.entries.iter_mut().for_each(Vec::clear);
        self.unsorted.clear();
        for &function in elements.active(elements.leaf(element)) {
            let lines = elements.lines(function);
            let mut meets = true;
            for a in 0..D {
                let state = &mut self.states[a][lines[a] as usize];
                if *state == UNSEEN {
                    let k = &knots[lines[a] as usize];
                    *state = if k[0] < high[a] && k[4] > low[a] {
                        MEETS
                    } else {
                        MISSES
                    };
                    self.touched[a].push(lines[a]);
                }
                meets &= *state != MISSES;
            }
            if !meets {
                continue;
            }
            let piece = std::array::from_fn(|a| {
                let state = &mut self.states[a][lines[a] as usize];
                if *state == MEETS {
                    *state = self.entries[a].len() as u16;
                    self.entries[a].push(elements.entry(lines[a], low[a], high[a]));
                }
                *state as u8
            });
            self.unsorted.push(Factor { function, piece });
        }
        for (states, touched) in self.states.iter_mut().zip(&mut self.touched) {
            for line in touched.drain(..) {
                states[line as usize] = UNSEEN;
            }
        }
    }

    /// Sort by piece, last axis first: sums over the factors then can be nested, along the first axis within the second
    /// within the third. No two functions have the same pieces along all axes.
    fn sort(&mut self) {
        self.factors.clear();
        let combinations: usize = self.entries.iter().map(Vec::len).product();
        let rank = |f: &Factor<D>, entries: &[Vec<u32>; D]| {
            (0..D)
                .rev()
                .fold(0, |rank, a| rank * entries[a].len() + f.piece[a] as usize)
        };
        if combinations > MAX_COUNTED {
            self.factors.extend_from_slice(&self.unsorted);
            self.factors.sort_unstable_by_key(|f| rank(f, &self.entries));
            return;
        }
        let nobody = Factor {
            function: u32::MAX,
            piece: [0; D],
        };
        if self.place.len() < combinations {
            self.place.resize(combinations, nobody);
        }
        self.taken.clear();
        self.taken.resize(combinations.div_ceil(64), 0);
        for f in &self.unsorted {
            let at = rank(f, &self.entries);
            self.place[at] = *f;
            self.taken[at / 64] |= 1 << (at % 64);
        }
        for (k, &taken) in self.taken.iter().enumerate() {
            let mut rest = taken;
            while rest != 0 {
                self.factors
                    .push(self.place[64 * k + rest.trailing_zeros() as usize]);
                rest &= rest - 1;
            }
        }
    }

    /// Whether sum B has the coefficients of the constant 1.
    fn is_unity(&self) -> bool {
        let near = |s: f64| s.abs() < 1e-13;
        // The constant coefficient alone settles most elements that are not.
        if !near(self.constant() - 1.0) {
            return false;
        }
        let mut sum: Tensor = [0.0; 64];
        nested_sum(&self.factors, &self.cubics, None, &mut sum);
        sum[0] -= 1.0;
        sum[..4_usize.pow(D as u32)].iter().all(|&s| near(s))
    }

    /// Constant coefficient of sum B, added up in the order of `nested_sum`.
    fn constant(&self) -> f64 {
        let (mut sum, mut plane, mut line) = (0.0, 0.0, 0.0);
        let mut k = 0;
        while k < self.factors.len() {
            let piece = &self.factors[k].piece;
            line += self.cubics[0][piece[0] as usize][0];
            k += 1;
            let next = self.factors.get(k).map(|f| &f.piece);
            if next.is_none_or(|next| next[1..] != piece[1..]) {
                plane += line * self.cubics[1][piece[1] as usize][0];
                line = 0.0;
            }
            if D > 2 && next.is_none_or(|next| next[D - 1] != piece[D - 1]) {
                sum += plane * self.cubics[D - 1][piece[D - 1] as usize][0];
                plane = 0.0;
            }
        }
        if D == 2 {
            plane
        } else {
            sum
        }
    }

    /// Basis functions on the element.
    #[inline]
    pub fn factors(&self) -> &[Factor<D>] {
        &self.factors
    }

    /// The element's different cubics along an axis.
    #[inline]
    pub fn pieces(&self, axis: usize) -> &[Cubic] {
        &self.cubics[axis][..self.entries[axis].len()]
    }

    /// As `pieces`, with places that are not used behind them.
    #[inline]
    pub fn cubics(&self) -> &Cubics<D> {
        &self.cubics
    }

    /// Table entries of the pieces along an axis.
    pub(crate) fn entries(&self, axis: usize) -> &[u32] {
        &self.entries[axis]
    }

    /// Where the element lies.
    #[inline]
    pub fn head(&self) -> &Head<D> {
        &self.head
    }

    /// Whether the B_i add up to 1 all over the element, so that no division is needed.
    #[inline]
    pub fn unity(&self) -> bool {
        self.unity
    }
}
