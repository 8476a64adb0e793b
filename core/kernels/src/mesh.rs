//! T-meshes: anchors with their ghost layer, local knots by ray shooting, elements.

use rayon::prelude::*;

use crate::element::Elements;
use crate::error::{KernelError, Result};
use crate::tree::{Tree, SIDE};

/// A frozen T-mesh over the unit box with one rational cubic basis function per anchor.
#[derive(Debug, Clone)]
pub struct TMesh<const D: usize> {
    tree: Tree<D>,
    /// Anchors in tree units; a boundary vertex appears once itself and once for each ghost.
    anchors: Vec<[u32; D]>,
    /// Five local knots an axis, in tree units.
    knots: Vec<[[u32; 5]; D]>,
    elements: Elements<D>,
}

impl<const D: usize> TMesh<D> {
    /// The T-mesh of a graded tree.
    pub fn new(tree: Tree<D>) -> Result<Self> {
        let (anchors, knots) = shoot_anchors(&tree);
        let elements = Elements::new(&tree, &knots)?;
        Ok(Self {
            tree,
            anchors,
            knots,
            elements,
        })
    }

    /// `2^level` cells an axis.
    pub fn uniform(level: u8) -> Result<Self> {
        Self::new(uniform_tree(level)?.finish())
    }

    pub fn tree(&self) -> &Tree<D> {
        &self.tree
    }

    pub fn anchors(&self) -> &[[u32; D]] {
        &self.anchors
    }

    pub fn knots(&self) -> &[[[u32; 5]; D]] {
        &self.knots
    }

    pub fn elements(&self) -> &Elements<D> {
        &self.elements
    }

    pub fn num_functions(&self) -> usize {
        self.anchors.len()
    }

    pub fn num_cells(&self) -> usize {
        self.tree.leaves().len()
    }

    /// Deepest level of a leaf.
    pub fn depth(&self) -> u8 {
        self.tree.leaves().iter().map(|l| l.level).max().unwrap_or(0)
    }

    /// One finite coefficient a function, or an error that says what was found.
    pub fn check_coefficients(&self, c: &[f64]) -> Result<()> {
        if c.len() != self.num_functions() {
            return Err(KernelError::Invalid(format!(
                "coefficients: found {} values for {} basis functions",
                c.len(),
                self.num_functions()
            )));
        }
        if let Some(k) = c.iter().position(|x| !x.is_finite()) {
            return Err(KernelError::Invalid(format!(
                "coefficients: value {k} is {}",
                c[k]
            )));
        }
        Ok(())
    }
}

/// The tree, not finished, of `2^level` cells an axis.
pub(crate) fn uniform_tree<const D: usize>(level: u8) -> Result<Tree<D>> {
    if level > 12 || (D == 3 && level > 8) {
        return Err(KernelError::TooLarge(format!(
            "a uniform mesh of depth {level} in {D}D is beyond the limit"
        )));
    }
    let mut tree = Tree::root();
    let step = SIDE >> level;
    let cells = 1_usize << level;
    for k in 0..cells.pow(D as u32) {
        let mut rest = k;
        let p = [(); D].map(|()| {
            let i = rest % cells;
            rest /= cells;
            i as u32 * step
        });
        tree.deepen(p, level);
    }
    Ok(tree)
}

/// Leaves in one unit of parallel work.
const CHUNK: usize = 512;

/// The leaves around a place, one for each side along each axis (bit a of the index: the upper side along axis a); `None`
/// beyond the boundary.
#[inline]
fn around<const D: usize>(tree: &Tree<D>, p: [u32; D], side: usize) -> Option<usize> {
    let mut q = p;
    for a in 0..D {
        if (side >> a) & 1 == 1 {
            if p[a] == SIDE {
                return None;
            }
        } else {
            q[a] = p[a].checked_sub(1)?;
        }
    }
    Some(tree.leaf_at(q))
}

/// The next place, from a place along `axis`, where the ray meets a face: the nearest far side among the leaves whose
/// closure holds the ray's first stretch, which `leaf` gives for each side. At the boundary the coordinate `here` itself,
/// which makes the zero-width ghost layer.
#[inline]
fn next_knot<const D: usize>(
    tree: &Tree<D>,
    here: u32,
    axis: usize,
    forward: bool,
    leaf: impl Fn(usize) -> Option<usize>,
) -> u32 {
    let nearest = (0..1_usize << D)
        .filter(|side| ((side >> axis) & 1 == 1) == forward)
        .filter_map(leaf)
        .map(|k| {
            let leaf = &tree.leaves()[k];
            leaf.corner[axis] + if forward { leaf.side() } else { 0 }
        });
    if forward { nearest.min() } else { nearest.max() }.unwrap_or(here)
}

/// Five knots an axis of the anchor at `p`, with the leaves around it.
fn local_knots<const D: usize>(tree: &Tree<D>, p: [u32; D], leaves: &[Option<usize>]) -> [[u32; 5]; D] {
    std::array::from_fn(|axis| {
        let walk = |forward| {
            let first = next_knot(tree, p[axis], axis, forward, |side| leaves[side]);
            let mut q = p;
            q[axis] = first;
            [
                first,
                next_knot(tree, first, axis, forward, |side| around(tree, q, side)),
            ]
        };
        let (back, ahead) = (walk(false), walk(true));
        [back[1], back[0], p[axis], ahead[0], ahead[1]]
    })
}

/// A vertex belongs to the first of the leaves that have it as a corner; anchors come in the order of these leaves.
fn shoot_anchors<const D: usize>(tree: &Tree<D>) -> (Vec<[u32; D]>, Vec<[[u32; 5]; D]>) {
    let leaves = tree.leaves();
    let chunks: Vec<(Vec<[u32; D]>, Vec<[[u32; 5]; D]>)> = (0..leaves.len().div_ceil(CHUNK))
        .into_par_iter()
        .map(|chunk| {
            let (mut anchors, mut knots) = (Vec::new(), Vec::new());
            for k in chunk * CHUNK..((chunk + 1) * CHUNK).min(leaves.len()) {
                for corner in 0..1_usize << D {
                    vertex(tree, k, corner, &mut anchors, &mut knots);
                }
            }
            (anchors, knots)
        })
        .collect();
    let count = chunks.iter().map(|c| c.0.len()).sum();
    let (mut anchors, mut knots) = (Vec::with_capacity(count), Vec::with_capacity(count));
    for (a, k) in chunks {
        anchors.extend(a);
        knots.extend(k);
    }
    (anchors, knots)
}

/// The anchors at a corner of a leaf, if it is the leaf's own.
fn vertex<const D: usize>(
    tree: &Tree<D>,
    leaf: usize,
    corner: usize,
    anchors: &mut Vec<[u32; D]>,
    knots: &mut Vec<[[u32; 5]; D]>,
) {
    let cell = &tree.leaves()[leaf];
    let mut p = cell.corner;
    for a in 0..D {
        p[a] += ((corner >> a) & 1) as u32 * cell.side();
    }
    let mut leaves = [None; 8];
    for side in 0..1_usize << D {
        leaves[side] = around(tree, p, side);
        // Only earlier leaves can own it instead.
        if let Some(other) = leaves[side].filter(|&other| other < leaf) {
            let other = &tree.leaves()[other];
            let is_corner =
                (0..D).all(|a| p[a] == other.corner[a] + ((!side >> a) & 1) as u32 * other.side());
            if is_corner {
                return;
            }
        }
    }
    let own = local_knots(tree, p, &leaves[..1 << D]);
    // Every axis on whose boundary the vertex lies doubles the anchors: itself, and the ghost one step out.
    for ghosts in 0..1_u32 << D {
        if (0..D).any(|a| (ghosts >> a) & 1 == 1 && p[a] != 0 && p[a] != SIDE) {
            continue;
        }
        let mut mine = own;
        for a in 0..D {
            if (ghosts >> a) & 1 == 1 {
                mine[a] = if p[a] == 0 {
                    [0, 0, 0, 0, own[a][3]]
                } else {
                    [own[a][1], SIDE, SIDE, SIDE, SIDE]
                };
            }
        }
        anchors.push(p);
        knots.push(mine);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn uniform_mesh_has_the_tensor_count() {
        for level in 0..5 {
            assert_eq!(
                TMesh::<2>::uniform(level).unwrap().num_functions(),
                ((1 << level) + 3_usize).pow(2)
            );
        }
        assert_eq!(TMesh::<3>::uniform(2).unwrap().num_functions(), 343);
    }
}
