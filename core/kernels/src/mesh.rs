//! T-meshes: anchors with their ghost layer, local knots by ray shooting, elements.

use rustc_hash::FxHashSet;

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
        Self::new(tree.finish())
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

/// The next place, from `p` along `axis`, where the ray meets a face: the nearest far side among the leaves whose closure
/// holds the ray's first stretch. At the boundary the coordinate itself, which makes the zero-width ghost layer.
fn next_knot<const D: usize>(tree: &Tree<D>, p: [u32; D], axis: usize, forward: bool) -> u32 {
    if (forward && p[axis] == SIDE) || (!forward && p[axis] == 0) {
        return p[axis];
    }
    let mut nearest: Option<u32> = None;
    for sides in 0..1_u32 << D {
        if (sides >> axis) & 1 == 1 {
            continue;
        }
        let mut q = p;
        let mut inside = true;
        for a in 0..D {
            if a == axis {
                q[a] = if forward { p[a] } else { p[a] - 1 };
            } else if (sides >> a) & 1 == 1 {
                inside &= p[a] > 0;
                q[a] = p[a].saturating_sub(1);
            } else {
                inside &= p[a] < SIDE;
            }
        }
        if !inside {
            continue;
        }
        let leaf = tree.leaves()[tree.leaf_at(q)];
        let far = if forward {
            leaf.corner[axis] + leaf.side()
        } else {
            leaf.corner[axis]
        };
        nearest = Some(match nearest {
            None => far,
            Some(n) if forward => n.min(far),
            Some(n) => n.max(far),
        });
    }
    nearest.unwrap_or(p[axis])
}

fn local_knots<const D: usize>(tree: &Tree<D>, p: [u32; D], axis: usize) -> [u32; 5] {
    let walk = |forward| {
        let first = next_knot(tree, p, axis, forward);
        let mut q = p;
        q[axis] = first;
        [first, next_knot(tree, q, axis, forward)]
    };
    let (back, ahead) = (walk(false), walk(true));
    [back[1], back[0], p[axis], ahead[0], ahead[1]]
}

fn shoot_anchors<const D: usize>(tree: &Tree<D>) -> (Vec<[u32; D]>, Vec<[[u32; 5]; D]>) {
    let mut seen: FxHashSet<[u32; D]> = FxHashSet::default();
    seen.reserve(2 * tree.leaves().len());
    let mut anchors = Vec::new();
    let mut knots = Vec::new();
    for leaf in tree.leaves() {
        for k in 0..1_u32 << D {
            let mut p = leaf.corner;
            for a in 0..D {
                p[a] += ((k >> a) & 1) * leaf.side();
            }
            if !seen.insert(p) {
                continue;
            }
            let own: [[u32; 5]; D] = std::array::from_fn(|a| local_knots(tree, p, a));
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
    }
    (anchors, knots)
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
