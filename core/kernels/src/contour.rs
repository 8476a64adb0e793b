//! Closed polylines on the zero set of a planar T-spline.
//!
//! Cells are cut into equal squares and these into triangles around their centres, with the midpoints of sides whose
//! neighbour is finer as further corners: a conforming triangulation, so that the lines close without cracks. Cells whose
//! coefficients have one sign hold no zero (the basis is positive) and are skipped, provably; so are squares on which the
//! Bernstein coefficients of the numerator have one sign.

use rayon::prelude::*;
use rustc_hash::FxHashMap;

use crate::bulk::evaluate;
use crate::error::{KernelError, Result};
use crate::evaluate::{field_at, Scratch};
use crate::mesh::TMesh;
pub use crate::net::Loops;
use crate::net::{chain, crossings, illinois, Edge, Net, Node};
use crate::polynomial::Quotient;
use crate::sign::live_squares;
use crate::tree::{Leaf, SIDE};

/// The zero set, cells cut into `2^subdivision` squares an axis. The outside of the box counts as f > 0, so that lines
/// end at the box's border and run along it.
pub fn loops(mesh: &TMesh<2>, c: &[f64], subdivision: u8) -> Result<Loops> {
    mesh.check_coefficients(c)?;
    if subdivision > 6 {
        return Err(KernelError::Invalid(format!(
            "subdivision: found {subdivision}, accepted is 0 to 6"
        )));
    }
    if mesh.depth() + subdivision >= 20 {
        return Err(KernelError::TooLarge(
            "mesh depth and subdivision together exceed 19".into(),
        ));
    }
    let cells: Vec<usize> = (0..mesh.num_cells())
        .filter(|&k| may_vanish(mesh, c, k))
        .collect();
    let squares: Vec<Leaf<2>> = cells
        .par_chunks(64)
        .flat_map_iter(|cells| {
            let mut quotient = Quotient::new();
            let mut out = Vec::new();
            for &k in cells {
                live_squares(mesh, &mut quotient, c, k, subdivision, &mut out);
            }
            out
        })
        .collect();
    let net = triangulate(mesh, c, &squares, subdivision)?;
    let (edges, next) = crossings(&net);
    let points: Vec<[f64; 2]> = edges
        .par_iter()
        .with_min_len(64)
        .map_init(
            || (Quotient::new(), Scratch::new()),
            |work, &edge| zero_on(mesh, work, c, edge, &net),
        )
        .collect();
    Ok(chain(&points, &next, 1e-14))
}

/// Whether the coefficients that act on a cell have both signs.
fn may_vanish(mesh: &TMesh<2>, c: &[f64], leaf: usize) -> bool {
    let (mut negative, mut positive) = (false, false);
    for &i in mesh.elements().active(leaf) {
        negative |= c[i as usize] < 0.0;
        positive |= c[i as usize] >= 0.0;
    }
    let cell = mesh.tree().leaves()[leaf];
    let border = cell.corner.iter().any(|&x| x == 0 || x + cell.side() == SIDE);
    negative && (positive || border)
}

/// Centre of a square, and the nodes around it counter-clockwise.
fn fan(mesh: &TMesh<2>, square: &Leaf<2>, subdivision: u8, ring: &mut Vec<Node>) -> Node {
    let [x, y] = square.corner;
    let s = square.side();
    let centre = [x + s / 2, y + s / 2];
    let corners = [[x, y], [x + s, y], [x + s, y + s], [x, y + s]];
    // A unit cell just across the middle of each side.
    let across = [
        (y > 0).then(|| [centre[0], y - 1]),
        (x + s < SIDE).then(|| [x + s, centre[1]]),
        (y + s < SIDE).then(|| [centre[0], y + s]),
        (x > 0).then(|| [x - 1, centre[1]]),
    ];
    ring.clear();
    for k in 0..4 {
        let (a, b) = (corners[k], corners[(k + 1) % 4]);
        ring.push(a);
        let finer = across[k]
            .is_some_and(|p| mesh.tree().leaves()[mesh.tree().leaf_at(p)].level + subdivision > square.level);
        if finer {
            ring.push([a[0].midpoint(b[0]), a[1].midpoint(b[1])]);
        }
    }
    centre
}

/// Triangles around the squares' centres, and the field at their nodes.
fn triangulate(mesh: &TMesh<2>, c: &[f64], squares: &[Leaf<2>], subdivision: u8) -> Result<Net> {
    let mut number: FxHashMap<Node, u32> = FxHashMap::default();
    number.reserve(3 * squares.len());
    let mut nodes = Vec::with_capacity(3 * squares.len());
    let mut triangles = Vec::with_capacity(4 * squares.len());
    let mut ring = Vec::with_capacity(8);
    for square in squares {
        // No other square has this centre.
        let centre = fan(mesh, square, subdivision, &mut ring);
        let middle = nodes.len() as u32;
        nodes.push(centre);
        let mut index = |node: Node| {
            *number.entry(node).or_insert_with(|| {
                nodes.push(node);
                (nodes.len() - 1) as u32
            })
        };
        let first = index(ring[0]);
        let mut last = first;
        for &node in &ring[1..] {
            let next = index(node);
            triangles.push([middle, last, next]);
            last = next;
        }
        triangles.push([middle, last, first]);
    }
    let places: Vec<[f64; 2]> = nodes.iter().map(|&n| place(n)).collect();
    let values = evaluate(mesh, c, &places, 0)?.values;
    Ok(Net {
        nodes,
        values,
        triangles,
        end: [SIDE; 2],
    })
}

fn place(node: Node) -> [f64; 2] {
    node.map(|x| f64::from(x) / f64::from(SIDE))
}

/// The zero on an edge: on the polynomials of the one element that holds it, as a rule.
fn zero_on(
    mesh: &TMesh<2>,
    work: &mut (Quotient<2>, Scratch<2>),
    c: &[f64],
    edge: Edge,
    net: &Net,
) -> [f64; 2] {
    let (quotient, scratch) = work;
    let ends = [edge.0 as usize, edge.1 as usize];
    let [a, b] = ends.map(|k| place(net.nodes[k]));
    if edge.0 == edge.1 {
        return a;
    }
    let values = ends.map(|k| net.values[k]);
    let elements = mesh.elements();
    let middle = [a[0].midpoint(b[0]), a[1].midpoint(b[1])];
    if let Some(e) = elements.locate(mesh.tree(), &middle) {
        let (corner, side) = elements.frame(e);
        let inside = |p: &[f64; 2]| (0..2).all(|k| (corner[k]..=corner[k] + side[k]).contains(&p[k]));
        if inside(&a) && inside(&b) {
            quotient.load(elements, e, c);
            return illinois(a, b, values, |x| quotient.at::<0>(x).value);
        }
    }
    illinois(a, b, values, |x| field_at::<2, 0>(mesh, scratch, c, x).value)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::refine::from_points;

    #[test]
    fn a_line_through_the_box_becomes_a_closed_half() {
        let mesh = from_points(&[[0.2, 0.3]], &[5], 1, 2, 10_000).unwrap();
        // Coefficients at the Greville abscissae make f close to x - 0.43.
        let c: Vec<f64> = mesh
            .knots()
            .iter()
            .map(|k| f64::from(k[0][1] + k[0][2] + k[0][3]) / 3.0 / f64::from(SIDE) - 0.43)
            .collect();
        let loops = loops(&mesh, &c, 1).unwrap();
        assert_eq!(loops.start.len(), 2);
        let v = &loops.vertices;
        let area: f64 = (0..v.len())
            .map(|k| {
                let (a, b) = (v[k], v[(k + 1) % v.len()]);
                0.5 * (a[0] * b[1] - a[1] * b[0])
            })
            .sum();
        assert!((area - 0.43).abs() < 0.01, "{area}");
    }
}
