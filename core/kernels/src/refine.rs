//! Making T-meshes: from sizes wanted at points, by splitting and by merging cells.

use rustc_hash::FxHashSet;

use crate::error::{KernelError, Result};
use crate::mesh::{uniform_tree, TMesh};
use crate::tree::{unit_cell, Tree, MAX_LEVEL, SIDE};

/// A graded mesh whose leaves have at least `levels[k]` in a block of `pad` cells (of that level) around `points[k]`, and
/// at least `base` everywhere. Points outside the box are refused.
pub fn from_points<const D: usize>(
    points: &[[f64; D]],
    levels: &[u8],
    pad: u32,
    base: u8,
    max_cells: usize,
) -> Result<TMesh<D>> {
    if points.len() != levels.len() {
        return Err(KernelError::Invalid(format!(
            "{} points for {} levels",
            points.len(),
            levels.len()
        )));
    }
    if let Some(k) = levels.iter().position(|&l| l > MAX_LEVEL) {
        return Err(KernelError::Invalid(format!(
            "level {} of point {k} exceeds {MAX_LEVEL}",
            levels[k]
        )));
    }
    let mut tree = uniform_tree::<D>(base)?;
    // Deep blocks first: their grading makes most of the coarser ones, whose search then ends at once.
    let mut blocks: Vec<(u8, [u32; D])> = Vec::new();
    let mut seen = FxHashSet::default();
    for (k, (x, &level)) in points.iter().zip(levels).enumerate() {
        if !x.iter().all(|v| (0.0..=1.0).contains(v)) {
            return Err(KernelError::Invalid(format!(
                "point {k} at {x:?} lies outside the unit box"
            )));
        }
        let block = (level, x.map(|v| unit_cell(v) >> (MAX_LEVEL - level)));
        if seen.insert(block) {
            blocks.push(block);
        }
    }
    blocks.sort_unstable_by_key(|b| std::cmp::Reverse(b.0));
    let too_large = || KernelError::TooLarge(format!("the mesh would have more than {max_cells} cells"));
    for (level, block) in blocks {
        let side = SIDE >> level;
        let low = block.map(|b| b.saturating_sub(pad));
        let extent: [u32; D] =
            std::array::from_fn(|a| block[a].saturating_add(pad).min(SIDE / side - 1) - low[a] + 1);
        // Every cell of the block holds a leaf at least: counted before any is made.
        let cells = extent.iter().fold(1_u64, |n, &e| n.saturating_mul(u64::from(e)));
        if cells > max_cells as u64 {
            return Err(too_large());
        }
        for k in 0..cells {
            let mut rest = k;
            let p = std::array::from_fn(|a| {
                let i = (rest % u64::from(extent[a])) as u32;
                rest /= u64::from(extent[a]);
                (low[a] + i) * side
            });
            tree.deepen(p, level);
        }
        if tree.count() > max_cells {
            return Err(too_large());
        }
    }
    tree.grade();
    if tree.count() > max_cells {
        return Err(too_large());
    }
    TMesh::new(tree.finish())
}

/// Every marked leaf split once, grading restored.
pub fn refine<const D: usize>(mesh: &TMesh<D>, mask: &[bool]) -> Result<TMesh<D>> {
    check_mask(mesh, mask)?;
    let mut tree = mesh.tree().clone();
    for (leaf, _) in mesh.tree().leaves().iter().zip(mask).filter(|(_, &m)| m) {
        if leaf.level == MAX_LEVEL {
            return Err(KernelError::TooLarge(format!(
                "a marked cell is at the deepest level {MAX_LEVEL}"
            )));
        }
        tree.deepen(leaf.corner, leaf.level + 1);
    }
    tree.grade();
    TMesh::new(tree.finish())
}

/// Families of `2^D` leaves of one parent that are all marked become that parent, where grading allows it.
pub fn coarsen<const D: usize>(mesh: &TMesh<D>, mask: &[bool]) -> Result<TMesh<D>> {
    check_mask(mesh, mask)?;
    let mut tree = Tree::root();
    let leaves = mesh.tree().leaves();
    let mut k = 0;
    while k < leaves.len() {
        let leaf = leaves[k];
        // Depth-first order: a complete family stands side by side and starts on its parent's corner.
        let family = leaf.level > 0
            && leaf.corner.iter().all(|c| c & (2 * leaf.side() - 1) == 0)
            && k + (1 << D) <= leaves.len()
            && (k..k + (1 << D)).all(|j| leaves[j].level == leaf.level && mask[j]);
        if family {
            tree.deepen(leaf.corner, leaf.level - 1);
            k += 1 << D;
        } else {
            tree.deepen(leaf.corner, leaf.level);
            k += 1;
        }
    }
    tree.grade();
    TMesh::new(tree.finish())
}

fn check_mask<const D: usize>(mesh: &TMesh<D>, mask: &[bool]) -> Result<()> {
    if mask.len() == mesh.num_cells() {
        Ok(())
    } else {
        Err(KernelError::Invalid(format!(
            "mask: found {} values for {} cells",
            mask.len(),
            mesh.num_cells()
        )))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn refine_then_coarsen_is_the_identity_on_uniform_meshes() {
        let mesh = TMesh::<2>::uniform(3).unwrap();
        let fine = refine(&mesh, &vec![true; mesh.num_cells()]).unwrap();
        assert_eq!(fine.num_cells(), 256);
        let back = coarsen(&fine, &vec![true; fine.num_cells()]).unwrap();
        assert_eq!(back.tree().leaves(), mesh.tree().leaves());
    }

    #[test]
    fn blocks_reach_the_level_asked_for() {
        let mesh = from_points(&[[0.3, 0.3]], &[6], 1, 2, 10_000).unwrap();
        assert_eq!(mesh.depth(), 6);
        assert!(from_points(&[[1.3, 0.3]], &[6], 1, 2, 10_000).is_err());
        assert!(from_points(&[[0.3, 0.3]], &[12], 40, 2, 1000).is_err());
    }
}
