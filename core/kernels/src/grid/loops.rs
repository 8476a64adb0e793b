//! Closed polylines on the zero set of a planar grid.

use rayon::prelude::*;
use rustc_hash::FxHashMap;

use super::blocks::Blocks;
use super::cells::live;
use super::interpolant::{evaluate, Interpolant};
use crate::error::{KernelError, Result};
use crate::net::{chain, crossings, illinois, Loops, Net, Node};
use crate::project::largest;
use crate::surface::MARGIN;

/// The zero set in index coordinates, cells cut into `2^subdivision` squares an axis and these into triangles around their
/// centres. The outside of the grid counts as f > 0.
pub fn loops(blocks: &Blocks<2>, subdivision: u8) -> Result<Loops> {
    if subdivision > 6 {
        return Err(KernelError::Invalid(format!(
            "subdivision: found {subdivision}, accepted is 0 to 6"
        )));
    }
    let cells = live(blocks, MARGIN * largest(blocks.values()));
    // Centres have odd places: two units of the lattice a square.
    let units = 2_u32 << subdivision;
    let net = triangulate(blocks, &cells, units)?;
    let (edges, next) = crossings(&net);
    let scale = 1.0 / f64::from(units);
    let points: Vec<[f64; 2]> = edges
        .par_iter()
        .with_min_len(64)
        .map_init(
            || Interpolant::new(blocks, &[1.0; 2]),
            |field, &(i, j)| {
                let [a, b] = [i, j].map(|k| net.nodes[k as usize].map(|x| f64::from(x) * scale));
                if i == j {
                    return a;
                }
                let values = [i, j].map(|k| net.values[k as usize]);
                illinois(a, b, values, |x| field.at::<0>(x).value)
            },
        )
        .collect();
    let widest = blocks.shape().into_iter().max().unwrap_or(1) as f64;
    Ok(chain(&points, &next, 1e-14 * widest))
}

/// Four triangles a square of the cells.
fn triangulate(blocks: &Blocks<2>, cells: &[[u32; 2]], units: u32) -> Result<Net> {
    let mut number: FxHashMap<Node, u32> = FxHashMap::default();
    let mut nodes = Vec::new();
    let mut triangles = Vec::new();
    for cell in cells {
        for k in 0..(units / 2).pow(2) {
            let [x, y] = [
                cell[0] * units + 2 * (k / (units / 2)),
                cell[1] * units + 2 * (k % (units / 2)),
            ];
            let mut index = |node: Node| {
                *number.entry(node).or_insert_with(|| {
                    nodes.push(node);
                    (nodes.len() - 1) as u32
                })
            };
            let middle = index([x + 1, y + 1]);
            let ring = [[x, y], [x + 2, y], [x + 2, y + 2], [x, y + 2]].map(&mut index);
            triangles.extend((0..4).map(|k| [middle, ring[k], ring[(k + 1) % 4]]));
        }
    }
    let scale = 1.0 / f64::from(units);
    let places: Vec<[f64; 2]> = nodes.iter().map(|n| n.map(|x| f64::from(x) * scale)).collect();
    let values = evaluate(blocks, &[1.0; 2], &places, 0)?.values;
    Ok(Net {
        nodes,
        values,
        triangles,
        end: blocks.shape().map(|n| (n as u32 - 1) * units),
    })
}
