//! The basis functions that act on each leaf, found by handing lists of functions down the tree.

use rayon::prelude::*;

use crate::tree::Tree;

/// The tree is cut into at least this many parts, whatever the number of threads.
const PARTS: usize = 64;

/// Children on the upper side along each axis, as bits.
const UPPER: [u32; 3] = [0b1010_1010, 0b1100_1100, 0b1111_0000];

/// Lower and upper corner of a function's support.
pub type Support<const D: usize> = [[u32; D]; 2];

/// Call `visit` for every leaf, depth first within a part, with the functions whose open support meets it, ascending. The
/// parts are disjoint stretches of the leaves, in order.
pub fn for_each_leaf<const D: usize, T: Send>(
    tree: &Tree<D>,
    supports: &[Support<D>],
    make: impl Fn() -> T + Sync,
    visit: impl Fn(&mut T, usize, &[u32]) + Sync,
) -> Vec<T> {
    let mut parts: Vec<(usize, Vec<u32>)> = vec![(0, (0..supports.len() as u32).collect())];
    while parts.len() < PARTS && parts.iter().any(|p| tree.children(p.0).is_some()) {
        let split: Vec<Vec<(usize, Vec<u32>)>> = parts
            .into_par_iter()
            .map(|(node, list)| match tree.children(node) {
                None => vec![(node, list)],
                Some(first) => {
                    let mut lists = vec![Vec::new(); 1 << D];
                    distribute(tree, first, &list, supports, &mut lists);
                    (first..).zip(lists).collect()
                }
            })
            .collect();
        parts = split.into_iter().flatten().collect();
    }
    parts
        .into_par_iter()
        .with_max_len(1)
        .map(|(node, list)| {
            let mut out = make();
            let mut spare = Vec::new();
            descend(tree, node, &list, supports, &mut spare, &mut |leaf, list| {
                visit(&mut out, leaf, list);
            });
            out
        })
        .collect()
}

fn descend<const D: usize>(
    tree: &Tree<D>,
    node: usize,
    list: &[u32],
    supports: &[Support<D>],
    spare: &mut Vec<Vec<Vec<u32>>>,
    visit: &mut impl FnMut(usize, &[u32]),
) {
    let Some(first) = tree.children(node) else {
        visit(tree.number(node), list);
        return;
    };
    let mut lists = spare.pop().unwrap_or_else(|| vec![Vec::new(); 1 << D]);
    distribute(tree, first, list, supports, &mut lists);
    for (child, list) in (first..).zip(&lists) {
        descend(tree, child, list, supports, spare, visit);
    }
    spare.push(lists);
}

/// Of the functions that meet a node, those that meet each child. The last child's lower corner is the node's centre.
fn distribute<const D: usize>(
    tree: &Tree<D>,
    first: usize,
    list: &[u32],
    supports: &[Support<D>],
    lists: &mut [Vec<u32>],
) {
    let centre = tree.cell(first + (1 << D) - 1).corner;
    lists.iter_mut().for_each(Vec::clear);
    for &i in list {
        let [low, high] = &supports[i as usize];
        let mut children = (1_u32 << (1 << D)) - 1;
        for a in 0..D {
            if low[a] >= centre[a] {
                children &= UPPER[a];
            }
            if high[a] <= centre[a] {
                children &= !UPPER[a];
            }
        }
        while children != 0 {
            lists[children.trailing_zeros() as usize].push(i);
            children &= children - 1;
        }
    }
}
