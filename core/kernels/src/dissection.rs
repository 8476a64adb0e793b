//! Geometric nested dissection: an elimination order with little fill, from the anchors' places.

use crate::pattern::Pattern;

/// Below this many unknowns a block is not cut further.
const BLOCK: usize = 24;

/// A block of unknowns that are eliminated together.
#[derive(Debug, Clone)]
pub struct Front {
    /// First unknown in elimination order, and their number.
    pub first: usize,
    pub columns: usize,
    /// Later unknowns that the block is coupled to, ascending, in elimination order.
    pub rows: Vec<u32>,
    /// Fronts of which this one is the parent: none, one or two, in order.
    pub children: Vec<usize>,
    /// Where the block's panel starts in the storage of the factor.
    pub panel: usize,
    /// The first front of this one's subtree.
    pub subtree: usize,
}

/// Elimination order and fronts in postorder.
#[derive(Debug, Clone)]
pub struct Dissection {
    /// `order[k]` is the unknown eliminated as the k-th.
    pub order: Vec<u32>,
    /// Inverse of `order`.
    pub place: Vec<u32>,
    pub fronts: Vec<Front>,
    pub panel_size: usize,
}

struct Builder<'a, const D: usize> {
    anchors: &'a [[u32; D]],
    pattern: &'a Pattern,
    side: Vec<u8>,
    order: Vec<u32>,
    fronts: Vec<Front>,
}

impl Dissection {
    pub fn new<const D: usize>(anchors: &[[u32; D]], pattern: &Pattern) -> Self {
        let n = anchors.len();
        let mut builder = Builder {
            anchors,
            pattern,
            side: vec![0; n],
            order: Vec::with_capacity(n),
            fronts: Vec::new(),
        };
        builder.dissect((0..n as u32).collect());
        let (order, mut fronts) = (builder.order, builder.fronts);
        let mut place = vec![0; n];
        for (k, &i) in order.iter().enumerate() {
            place[i as usize] = k as u32;
        }
        let panel_size = symbolic(pattern, &order, &place, &mut fronts);
        Self {
            order,
            place,
            fronts,
            panel_size,
        }
    }

    /// Entries of the factor.
    pub fn fill(&self) -> usize {
        self.panel_size
    }
}

impl<const D: usize> Builder<'_, D> {
    /// Order `set`, children first; returns the front on top of it (none for an empty set).
    fn dissect(&mut self, mut set: Vec<u32>) -> Option<usize> {
        if set.is_empty() {
            return None;
        }
        let subtree = self.fronts.len();
        let mut children = Vec::new();
        if set.len() > BLOCK {
            if let Some((left, right, separator)) = self.cut(&set) {
                children.extend(self.dissect(left));
                children.extend(self.dissect(right));
                set = separator;
            }
        }
        if set.is_empty() {
            // Two parts without any coupling: an empty block joins them.
            if children.len() == 1 {
                return children.pop();
            }
        }
        let first = self.order.len();
        self.order.extend_from_slice(&set);
        self.fronts.push(Front {
            first,
            columns: set.len(),
            rows: Vec::new(),
            children,
            panel: 0,
            subtree,
        });
        Some(self.fronts.len() - 1)
    }

    /// Two uncoupled parts and the separator between them; none when no axis can be cut.
    fn cut(&mut self, set: &[u32]) -> Option<(Vec<u32>, Vec<u32>, Vec<u32>)> {
        let axis = (0..D).max_by_key(|&a| {
            let range = set.iter().map(|&i| self.anchors[i as usize][a]);
            range.clone().max().unwrap_or(0) - range.min().unwrap_or(0)
        })?;
        let mut places: Vec<u32> = set.iter().map(|&i| self.anchors[i as usize][axis]).collect();
        let (_, &mut middle, _) = places.select_nth_unstable(set.len() / 2);
        for &i in set {
            self.side[i as usize] = 1 + u8::from(self.anchors[i as usize][axis] >= middle);
        }
        if set.iter().all(|&i| self.side[i as usize] == 2) {
            for &i in set {
                self.side[i as usize] = 0;
            }
            return None;
        }
        let touches = |side: &[u8], i: u32, other: u8| {
            self.pattern
                .row(i as usize)
                .iter()
                .any(|&j| side[j as usize] == other)
        };
        let border = |s: u8| {
            let of_side = set.iter().copied().filter(|&i| self.side[i as usize] == s);
            of_side
                .filter(|&i| touches(&self.side, i, 3 - s))
                .collect::<Vec<u32>>()
        };
        let (from_left, from_right) = (border(1), border(2));
        let separator = if from_right.len() <= from_left.len() {
            from_right
        } else {
            from_left
        };
        for &i in &separator {
            self.side[i as usize] = 3;
        }
        let part = |s: u8| {
            set.iter()
                .copied()
                .filter(|&i| self.side[i as usize] == s)
                .collect::<Vec<u32>>()
        };
        let (left, right) = (part(1), part(2));
        for &i in set {
            self.side[i as usize] = 0;
        }
        // A separator that takes nearly everything gains nothing.
        (separator.len() * 3 < set.len() * 2).then_some((left, right, separator))
    }
}

/// Rows of every front and the places of the panels; returns the storage needed.
fn symbolic(pattern: &Pattern, order: &[u32], place: &[u32], fronts: &mut [Front]) -> usize {
    let mut panel = 0;
    let mut seen = vec![u32::MAX; order.len()];
    for k in 0..fronts.len() {
        let (done, rest) = fronts.split_at_mut(k);
        let front = &mut rest[0];
        let end = front.first + front.columns;
        let mut rows = Vec::new();
        let mut add = |r: u32| {
            if r as usize >= end && seen[r as usize] != k as u32 {
                seen[r as usize] = k as u32;
                rows.push(r);
            }
        };
        for &i in &order[front.first..end] {
            pattern
                .row(i as usize)
                .iter()
                .for_each(|&j| add(place[j as usize]));
        }
        for &child in &front.children {
            done[child].rows.iter().copied().for_each(&mut add);
        }
        rows.sort_unstable();
        front.panel = panel;
        panel += front.columns * (front.columns + rows.len());
        front.rows = rows;
    }
    panel
}
