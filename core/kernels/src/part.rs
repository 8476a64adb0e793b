//! The leaves of a part of a tree, cut into elements.

use rustc_hash::FxHashSet;

/// What a part of the tree contributes.
pub struct Part<const D: usize> {
    pub boxes: Vec<[[u32; D]; 2]>,
    /// For each leaf its numbers of elements, of breaks along each axis and of functions.
    pub counts: Vec<(u32, [u32; D], u32)>,
    pub breaks: Vec<u32>,
    pub active: Vec<u32>,
    pub spans: FxHashSet<[u32; 3]>,
    /// Work space: the leaf that saw univariate knots last, the different ones on the leaf, and its cuts.
    seen: [Vec<u32>; D],
    different: [Vec<u32>; D],
    cuts: [Vec<u32>; D],
    pub most_pieces: usize,
}

impl<const D: usize> Part<D> {
    pub fn new(different: usize) -> Self {
        Self {
            boxes: Vec::new(),
            counts: Vec::new(),
            breaks: Vec::new(),
            active: Vec::new(),
            spans: FxHashSet::default(),
            seen: std::array::from_fn(|_| vec![u32::MAX; different]),
            different: std::array::from_fn(|_| Vec::new()),
            cuts: std::array::from_fn(|_| Vec::new()),
            most_pieces: 0,
        }
    }

    /// Add a leaf, with the functions that act on it and the knots of all functions.
    pub fn leaf(
        &mut self,
        leaf: u32,
        [low, high]: [[u32; D]; 2],
        list: &[u32],
        lines: &[[u32; D]],
        knots: &[[u32; 5]],
    ) {
        self.different.iter_mut().for_each(Vec::clear);
        for &i in list {
            for (a, &line) in lines[i as usize].iter().enumerate() {
                let seen = &mut self.seen[a][line as usize];
                if *seen != leaf {
                    *seen = leaf;
                    self.different[a].push(line);
                }
            }
        }
        for (a, cuts) in self.cuts.iter_mut().enumerate() {
            let different = &self.different[a];
            self.most_pieces = self.most_pieces.max(different.len());
            cuts.clear();
            cuts.extend([low[a], high[a]]);
            // Only the knots that cut the leaf, which many leaves do not have.
            for &line in different {
                cuts.extend(
                    knots[line as usize]
                        .iter()
                        .filter(|&&x| low[a] < x && x < high[a]),
                );
            }
            if cuts.len() > 2 {
                cuts.sort_unstable();
                cuts.dedup();
            }
            self.breaks.extend_from_slice(&cuts[1..cuts.len() - 1]);
            for ends in cuts.windows(2) {
                for &line in different {
                    let k = &knots[line as usize];
                    if k[0] < ends[1] && k[4] > ends[0] {
                        self.spans.insert([line, ends[0], ends[1]]);
                    }
                }
            }
        }
        let elements: usize = self.cuts.iter().map(|x| x.len() - 1).product();
        for k in 0..elements {
            let mut rest = k;
            let (mut lo, mut hi) = ([0; D], [0; D]);
            for (a, cuts) in self.cuts.iter().enumerate() {
                let i = rest % (cuts.len() - 1);
                rest /= cuts.len() - 1;
                (lo[a], hi[a]) = (cuts[i], cuts[i + 1]);
            }
            self.boxes.push([lo, hi]);
        }
        let breaks = std::array::from_fn(|a| self.cuts[a].len() as u32 - 2);
        self.counts.push((elements as u32, breaks, list.len() as u32));
        self.active.extend_from_slice(list);
    }

    /// Give the work space back.
    pub fn finish(&mut self) {
        self.seen = std::array::from_fn(|_| Vec::new());
        self.boxes.shrink_to_fit();
        self.active.shrink_to_fit();
    }
}
