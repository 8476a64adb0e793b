//! Quadtrees and octrees over the unit box, dimension-generic, on integer coordinates.

use crate::error::{KernelError, Result};

/// Levels below the root that the integer coordinates can hold.
pub const MAX_LEVEL: u8 = 20;
/// Side of the unit box in tree units.
pub const SIDE: u32 = 1 << MAX_LEVEL;

const NONE: u32 = u32::MAX;

/// A leaf: its lower corner in tree units and its level.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Leaf<const D: usize> {
    pub corner: [u32; D],
    pub level: u8,
}

impl<const D: usize> Leaf<D> {
    /// Side in tree units.
    pub fn side(&self) -> u32 {
        SIDE >> self.level
    }
}

/// A tree whose cells have all `2^D` children or none. While it is built, nodes are split in any order; `finish`
/// renumbers the leaves depth first, which keeps neighbours close in memory.
#[derive(Debug, Clone)]
pub struct Tree<const D: usize> {
    /// First child of a node, or `NONE` for a leaf. Child k of a node holds the upper half of axis a iff bit a of k is 1.
    children: Vec<u32>,
    nodes: Vec<Leaf<D>>,
    /// Leaf number of a node, `NONE` for inner nodes; valid after `finish`.
    number: Vec<u32>,
    leaves: Vec<Leaf<D>>,
    /// Nodes at `shortcut_level` (or the leaves above it) by lattice position; made by `finish`.
    shortcut: Vec<u32>,
    shortcut_level: u8,
}

impl<const D: usize> Tree<D> {
    /// The root alone.
    pub fn root() -> Self {
        let root = Leaf {
            corner: [0; D],
            level: 0,
        };
        Self {
            children: vec![NONE],
            nodes: vec![root],
            number: vec![0],
            leaves: vec![root],
            shortcut: vec![0],
            shortcut_level: 0,
        }
    }

    /// Leaves in depth-first order.
    pub fn leaves(&self) -> &[Leaf<D>] {
        &self.leaves
    }

    /// Number of leaves of the tree being built.
    pub fn count(&self) -> usize {
        (self.nodes.len() * ((1 << D) - 1)).div_ceil(1 << D)
    }

    /// The cell at `p` of `level`, or the leaf above it.
    fn descend(&self, p: [u32; D], level: u8) -> usize {
        let mut node = 0;
        let mut shift = MAX_LEVEL;
        while self.children[node] != NONE && shift > MAX_LEVEL - level {
            shift -= 1;
            let mut child = 0;
            for a in 0..D {
                child |= ((p[a] >> shift) & 1) << a;
            }
            node = (self.children[node] + child) as usize;
        }
        node
    }

    /// The child at `p` of a node that has children.
    fn child(&self, node: usize, p: [u32; D]) -> usize {
        let half = SIDE >> (self.nodes[node].level + 1);
        let child: u32 = (0..D).map(|a| u32::from(p[a] & half != 0) << a).sum();
        (self.children[node] + child) as usize
    }

    fn split(&mut self, node: usize) {
        let Leaf { corner, level } = self.nodes[node];
        let half = SIDE >> (level + 1);
        self.children[node] = self.nodes.len() as u32;
        for k in 0..1_u32 << D {
            let mut c = corner;
            for a in 0..D {
                c[a] += ((k >> a) & 1) * half;
            }
            self.nodes.push(Leaf {
                corner: c,
                level: level + 1,
            });
            self.children.push(NONE);
        }
    }

    /// Number of the leaf that holds the unit cell at `p`; every coordinate below `SIDE`. Only after `finish`.
    #[inline]
    pub fn leaf_at(&self, p: [u32; D]) -> usize {
        let mut shift = MAX_LEVEL - self.shortcut_level;
        let mut at = 0;
        for a in (0..D).rev() {
            at = (at << self.shortcut_level) | (p[a] >> shift) as usize;
        }
        let mut node = self.shortcut[at] as usize;
        while self.children[node] != NONE {
            shift -= 1;
            let mut child = 0;
            for a in 0..D {
                child |= ((p[a] >> shift) & 1) << a;
            }
            node = (self.children[node] + child) as usize;
        }
        self.number[node] as usize
    }

    /// Split until the leaf at `p` has at least `level`.
    pub fn deepen(&mut self, p: [u32; D], level: u8) {
        let mut node = self.descend(p, level);
        while self.nodes[node].level < level {
            self.split(node);
            node = self.child(node, p);
        }
    }

    /// Split until cells that touch, corners included, differ by one level at most: that is, until all neighbours of a
    /// cell with children are cells too.
    pub fn grade(&mut self) {
        let mut queue: Vec<usize> = (0..self.nodes.len())
            .filter(|&k| self.children[k] != NONE)
            .collect();
        while let Some(node) = queue.pop() {
            let cell = self.nodes[node];
            for direction in 0..3_usize.pow(D as u32) {
                let Some(p) = neighbour_probe(&cell, direction) else {
                    continue;
                };
                let mut other = self.descend(p, cell.level);
                while self.nodes[other].level < cell.level {
                    self.split(other);
                    queue.push(other);
                    other = self.child(other, p);
                }
            }
        }
    }

    /// Number the leaves depth first and make the lattice of shortcuts.
    #[must_use]
    pub fn finish(mut self) -> Self {
        self.number = vec![NONE; self.nodes.len()];
        self.leaves.clear();
        let mut stack = vec![0_usize];
        while let Some(node) = stack.pop() {
            if self.children[node] == NONE {
                self.number[node] = self.leaves.len() as u32;
                self.leaves.push(self.nodes[node]);
            } else {
                let first = self.children[node] as usize;
                stack.extend((first..first + (1 << D)).rev());
            }
        }
        // As fine as a lattice may be without outgrowing what the tree itself takes.
        let mut level = 0_u8;
        while level < 8 && 1_usize << (D * (usize::from(level) + 1)) <= 4 * self.nodes.len() {
            level += 1;
        }
        self.shortcut = vec![0; 1 << (D * usize::from(level))];
        for node in 0..self.nodes.len() {
            let Leaf { corner, level: depth } = self.nodes[node];
            if depth == level || (depth < level && self.children[node] == NONE) {
                let span = 1_usize << (level - depth);
                for k in 0..span.pow(D as u32) {
                    let (mut rest, mut at) = (k, 0);
                    for a in (0..D).rev() {
                        at = (at << level) | ((corner[a] >> (MAX_LEVEL - level)) as usize + rest % span);
                        rest /= span;
                    }
                    self.shortcut[at] = node as u32;
                }
            }
        }
        self.shortcut_level = level;
        self
    }

    /// The tree with exactly the given leaves.
    ///
    /// Refused: levels beyond `MAX_LEVEL`, corners off the lattice of their level or outside, overlaps, holes, and
    /// touching cells that differ by more than one level.
    pub fn from_leaves(leaves: &[Leaf<D>]) -> Result<Self> {
        let mut tree = Self::root();
        for (k, leaf) in leaves.iter().enumerate() {
            let ok = leaf.level <= MAX_LEVEL
                && leaf
                    .corner
                    .iter()
                    .all(|&c| c < SIDE && c & ((SIDE >> leaf.level) - 1) == 0);
            if !ok {
                return Err(KernelError::Invalid(format!(
                    "leaf {k} has corner {:?} and level {}, which is no cell of a tree over [0, {SIDE}]^{D}",
                    leaf.corner, leaf.level
                )));
            }
            tree.deepen(leaf.corner, leaf.level);
            // Deepening makes 2^D leaves a split; more nodes than that means holes or overlaps.
            if tree.count() > leaves.len() {
                return Err(KernelError::Invalid(format!(
                    "the first {} of {} leaves imply more cells than are given: there are holes or overlaps",
                    k + 1,
                    leaves.len()
                )));
            }
        }
        let before = tree.nodes.len();
        tree.grade();
        if tree.nodes.len() != before {
            return Err(KernelError::Invalid(
                "cells that touch differ by more than one level".into(),
            ));
        }
        let tree = tree.finish();
        let mut given: Vec<_> = leaves.iter().map(|l| (l.corner, l.level)).collect();
        let mut made: Vec<_> = tree.leaves.iter().map(|l| (l.corner, l.level)).collect();
        given.sort_unstable();
        made.sort_unstable();
        if given != made {
            return Err(KernelError::Invalid(
                "the leaves do not tile the box: holes, overlaps or duplicates".into(),
            ));
        }
        Ok(tree)
    }

    /// First of a node's `2^D` children, which are numbered in a row; `None` for a leaf. Node 0 is the root.
    #[inline]
    pub fn children(&self, node: usize) -> Option<usize> {
        let first = self.children[node];
        (first != NONE).then_some(first as usize)
    }

    /// Corner and level of a node.
    #[inline]
    pub fn cell(&self, node: usize) -> &Leaf<D> {
        &self.nodes[node]
    }

    /// Leaf number of a node that is a leaf. Only after `finish`.
    #[inline]
    pub fn number(&self, node: usize) -> usize {
        self.number[node] as usize
    }
}

/// A unit cell just beyond the `direction`-th of the `3^D` sides and corners of a cell; `None` for the cell itself and
/// beyond the box. A neighbour that is not finer covers the whole of that side, so that one probe is enough.
pub fn neighbour_probe<const D: usize>(cell: &Leaf<D>, direction: usize) -> Option<[u32; D]> {
    let mut p = cell.corner;
    let mut rest = direction;
    let mut moved = false;
    for q in &mut p {
        match rest % 3 {
            0 => {}
            1 => {
                *q = q.checked_sub(1)?;
                moved = true;
            }
            _ => {
                *q += cell.side();
                if *q >= SIDE {
                    return None;
                }
                moved = true;
            }
        }
        rest /= 3;
    }
    moved.then_some(p)
}

/// Tree units of a coordinate of the unit box, the upper end included in the last unit cell.
#[inline]
pub fn unit_cell(x: f64) -> u32 {
    ((x * f64::from(SIDE)) as u32).min(SIDE - 1)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn grading_holds_over_corners() {
        let mut tree = Tree::<2>::root();
        tree.deepen([SIDE / 2 - 1, SIDE / 2 - 1], 7);
        tree.grade();
        let tree = tree.finish();
        for cell in tree.leaves() {
            for direction in 0..9 {
                if let Some(p) = neighbour_probe(cell, direction) {
                    assert!(tree.leaves()[tree.leaf_at(p)].level + 1 >= cell.level);
                }
            }
        }
        assert!(Tree::from_leaves(tree.leaves()).is_ok());
    }

    #[test]
    fn hostile_leaves_are_refused() {
        let quarter = |x, y| Leaf {
            corner: [x * SIDE / 2, y * SIDE / 2],
            level: 1,
        };
        let good = [quarter(0, 0), quarter(1, 0), quarter(0, 1), quarter(1, 1)];
        assert!(Tree::from_leaves(&good).is_ok());
        assert!(Tree::from_leaves(&good[..3]).is_err());
        assert!(Tree::from_leaves(&[good[0], good[0], good[1], good[2]]).is_err());
        assert!(Tree::<2>::from_leaves(&[]).is_err());
        let off = Leaf {
            corner: [3, 0],
            level: 1,
        };
        assert!(Tree::from_leaves(&[good[0], off, good[2], good[3]]).is_err());
        let deep = Leaf {
            corner: [0, 0],
            level: 255,
        };
        assert!(Tree::from_leaves(&[deep]).is_err());
    }
}
