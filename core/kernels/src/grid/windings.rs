//! How often a closed surface winds around the nodes of a grid.
//!
//! Along each line of nodes of the last axis the winding number changes where the line goes through a triangle. Lines
//! and triangles are told apart by exact predicates, and a line that meets an edge or a corner counts as shifted by an
//! infinitesimal: the numbers are those of the definition, whatever the surface does with itself. Pseudonormals at the
//! nearest feature would need no lines, but take a hidden wall for a boundary.

use rayon::prelude::*;
use robust::{orient2d, Coord};

use super::nodes::Nodes;

/// Triangles a chunk: fixed, so that crossings come in one order for any number of threads.
const CHUNK: usize = 1024;

/// A line's way through a triangle.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
struct Crossing {
    line: u32,
    /// First node behind it.
    node: u32,
    /// What it adds to the winding number.
    turn: i32,
}

/// Winding numbers of all nodes, as their changes along lines.
#[derive(Debug)]
pub struct Windings {
    lines: usize,
    start: Vec<u32>,
    crossings: Vec<Crossing>,
}

impl Windings {
    /// The surface must be closed, its triangles counter-clockwise seen from outside.
    pub fn new(vertices: &[[f64; 3]], faces: &[[u32; 3]], nodes: &Nodes) -> Self {
        let mut crossings: Vec<Crossing> = faces
            .par_chunks(CHUNK)
            .flat_map_iter(|chunk| {
                let mut found = Vec::new();
                for face in chunk {
                    cross(face.map(|v| vertices[v as usize]), nodes, &mut found);
                }
                found
            })
            .collect();
        crossings.par_sort_unstable();
        let [rows, lines, _] = nodes.shape;
        let mut start = vec![0_u32; rows * lines + 1];
        for crossing in &crossings {
            start[crossing.line as usize + 1] += 1;
        }
        for k in 1..start.len() {
            start[k] += start[k - 1];
        }
        Self {
            lines,
            start,
            crossings,
        }
    }

    /// Whether the surface winds around a node once or more.
    #[inline]
    pub fn inside(&self, node: [usize; 3]) -> bool {
        let line = node[0] * self.lines + node[1];
        self.crossings[self.start[line] as usize..self.start[line + 1] as usize]
            .iter()
            .take_while(|c| c.node as usize <= node[2])
            .map(|c| c.turn)
            .sum::<i32>()
            > 0
    }
}

/// The crossings of all lines with one triangle.
fn cross(corners: [[f64; 3]; 3], nodes: &Nodes, found: &mut Vec<Crossing>) {
    let flat = corners.map(|p| Coord { x: p[0], y: p[1] });
    let area = orient2d(flat[0], flat[1], flat[2]);
    if area == 0.0 {
        // The shifted lines pass it by.
        return;
    }
    let (low, high) = span(corners.iter().map(|p| p[0]));
    for i in nodes.between(0, low, high) {
        let x = nodes.coordinate(0, i);
        let (low, high) = slice(&corners, x);
        for j in nodes.between(1, low, high) {
            let line = Coord {
                x,
                y: nodes.coordinate(1, j),
            };
            let parts = [(1, 2), (2, 0), (0, 1)].map(|(a, b)| side(flat[a], flat[b], line));
            if !parts.iter().all(|&(left, _)| left == (area > 0.0)) {
                continue;
            }
            let sum: f64 = parts.iter().map(|p| p.1).sum();
            let height = (0..3).map(|k| parts[k].1 / sum * corners[k][2]).sum::<f64>();
            let node = nodes.above(2, height);
            if node < nodes.shape[2] {
                found.push(Crossing {
                    line: (i * nodes.shape[1] + j) as u32,
                    node: node as u32,
                    turn: if area < 0.0 { 1 } else { -1 },
                });
            }
        }
    }
}

/// Whether a point lies left of the line from a to b, and twice the area of the three. On the line it counts as shifted
/// by (e, e^2) for an infinitesimal e > 0, in all triangles alike.
fn side(a: Coord<f64>, b: Coord<f64>, point: Coord<f64>) -> (bool, f64) {
    let area = orient2d(a, b, point);
    let left = if area.abs() > 0.0 {
        area > 0.0
    } else {
        a.y > b.y || a.y >= b.y && b.x > a.x
    };
    (left, area)
}

/// Range along the second axis of the part of a triangle at `x`, which lies within it but for rounding.
fn slice(corners: &[[f64; 3]; 3], x: f64) -> (f64, f64) {
    let sides = [(0, 1), (1, 2), (2, 0)].map(|(a, b)| (corners[a], corners[b]));
    // A line beyond the triangle by rounding meets no side: the range is empty.
    let met = sides.into_iter().filter(|(a, b)| (x - a[0]) * (x - b[0]) <= 0.0);
    let ends = met.flat_map(|(a, b)| {
        let run = b[0] - a[0];
        if run.abs() > 0.0 {
            [a[1] + ((x - a[0]) / run).clamp(0.0, 1.0) * (b[1] - a[1]); 2]
        } else {
            [a[1], b[1]]
        }
    });
    span(ends)
}

fn span(values: impl Iterator<Item = f64>) -> (f64, f64) {
    values.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), v| {
        (low.min(v), high.max(v))
    })
}
