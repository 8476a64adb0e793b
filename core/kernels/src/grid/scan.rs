//! Signed distances to a closed triangle mesh on the nodes near it.
//!
//! Each triangle visits the nodes within the band around it, block by block; signs are winding numbers, of the far
//! blocks as well. Time and memory grow with the surface, not with the box.

use rayon::prelude::*;

use super::blocks::{Blocks, SIDE};
use super::nodes::Nodes;
use super::triangle::Triangle;
use super::windings::Windings;
use crate::error::{KernelError, Result};

/// Triangles a chunk.
const CHUNK: usize = 256;

const VOLUME: usize = Blocks::<3>::VOLUME;

/// Exact distances within `far` of the triangles, below zero inside; beyond it the sign only.
///
/// The mesh must be closed and outward (the winding numbers have no meaning otherwise); triangles may have no area and
/// may cut one another, inside is where the mesh winds around once or more.
pub fn scan_convert(vertices: &[[f64; 3]], faces: &[[u32; 3]], nodes: &Nodes, far: f64) -> Result<Blocks<3>> {
    validate(vertices, faces, nodes, far)?;
    let mut blocks = Blocks::<3>::new(nodes.shape, far)?;
    let pairs = visits(vertices, faces, nodes, far, blocks.counts());
    let groups: Vec<&[(u32, u32)]> = pairs.chunk_by(|a, b| a.0 == b.0).collect();
    let windings = Windings::new(vertices, faces, nodes);
    mark_far(&mut blocks, &windings);
    let counts = blocks.counts();
    let places: Vec<[u32; 3]> = groups.iter().map(|g| place(g[0].0 as usize, counts)).collect();
    blocks.store(&places);
    let kept: Vec<bool> = blocks
        .values_mut()
        .par_chunks_mut(VOLUME)
        .zip(&groups)
        .zip(&places)
        .map(|((values, group), place)| {
            values.fill(far);
            let corners = |t: u32| faces[t as usize].map(|v| vertices[v as usize]);
            for &(_, t) in *group {
                visit(corners(t), nodes, far, place, values);
            }
            let near = values.iter().any(|&v| v < far);
            for (offset, v) in values.iter_mut().enumerate() {
                let node = Blocks::<3>::node(place, offset);
                if (0..3).all(|q| node[q] < nodes.shape[q]) && windings.inside(node) {
                    *v = -*v;
                }
            }
            near
        })
        .collect();
    if kept.contains(&false) {
        blocks.keep(&kept);
    }
    blocks.pad();
    Ok(blocks)
}

fn validate(vertices: &[[f64; 3]], faces: &[[u32; 3]], nodes: &Nodes, far: f64) -> Result<()> {
    let invalid = |text: String| Err(KernelError::Invalid(text));
    if let Some(k) = vertices.iter().position(|p| p.iter().any(|x| !x.is_finite())) {
        return invalid(format!(
            "vertices: found {:?} in row {k}, accepted are finite numbers",
            vertices[k]
        ));
    }
    if let Some(k) = faces
        .iter()
        .position(|f| f.iter().any(|&v| v as usize >= vertices.len()))
    {
        return invalid(format!(
            "faces: found {:?} in row {k}, accepted are numbers below {}",
            faces[k],
            vertices.len()
        ));
    }
    // A surface between two nodes of different blocks has to be near to both, or far signs would meet without a band.
    let least = nodes.spacing.iter().copied().fold(0.0, f64::max);
    if !far.is_finite() || far < least {
        return invalid(format!(
            "far: found {far}, accepted are lengths of at least a spacing, {least}"
        ));
    }
    Ok(())
}

/// Signs of all blocks, by those of their first nodes: where no triangle is near, the others are the same.
fn mark_far(blocks: &mut Blocks<3>, windings: &Windings) {
    let counts = blocks.counts();
    let inside: Vec<u32> = (0..(counts[0] * counts[1] * counts[2]) as u32)
        .into_par_iter()
        .filter(|&b| windings.inside(place(b as usize, counts).map(|p| p as usize * SIDE)))
        .collect();
    for b in inside {
        blocks.set_inside(&place(b as usize, counts), true);
    }
}

/// (block, triangle) for all blocks with a node within `far` of the triangle, and few others; ascending.
fn visits(
    vertices: &[[f64; 3]],
    faces: &[[u32; 3]],
    nodes: &Nodes,
    far: f64,
    counts: [usize; 3],
) -> Vec<(u32, u32)> {
    let mut pairs: Vec<(u32, u32)> = faces
        .par_chunks(CHUNK)
        .enumerate()
        .flat_map_iter(|(c, chunk)| {
            let mut found = Vec::new();
            for (k, face) in chunk.iter().enumerate() {
                let corners = face.map(|v| vertices[v as usize]);
                let reach = Reach {
                    triangle: Triangle::new(corners[0], corners[1], corners[2]),
                    number: (c * CHUNK + k) as u32,
                    nodes,
                    far,
                    counts,
                };
                let range: [_; 3] = std::array::from_fn(|q| near(&corners, nodes, far, q));
                if range.iter().all(|r| !r.is_empty()) {
                    let low = std::array::from_fn(|q| range[q].start / SIDE);
                    let high = std::array::from_fn(|q| (range[q].end - 1) / SIDE + 1);
                    reach.descend(low, high, &mut found);
                }
            }
            found
        })
        .collect();
    pairs.par_sort_unstable();
    pairs
}

/// What decides which blocks a triangle visits.
struct Reach<'a> {
    triangle: Triangle,
    number: u32,
    nodes: &'a Nodes,
    far: f64,
    counts: [usize; 3],
}

impl Reach<'_> {
    /// Halve a box of blocks while its ball meets the band: long oblique triangles have bounding boxes full of blocks
    /// that they never come near.
    fn descend(&self, low: [usize; 3], high: [usize; 3], found: &mut Vec<(u32, u32)>) {
        let ends = [low.map(|b| b * SIDE), high.map(|b| b * SIDE - 1)].map(|node| self.nodes.point(node));
        let center = std::array::from_fn(|q| 0.5 * (ends[0][q] + ends[1][q]));
        let square: f64 = (0..3).map(|q| (ends[1][q] - center[q]).powi(2)).sum();
        if self.triangle.distance(center) > self.far + square.sqrt() * (1.0 + 1e-12) {
            return;
        }
        let sides: [usize; 3] = std::array::from_fn(|q| high[q] - low[q]);
        if sides == [1; 3] {
            let number = (low[0] * self.counts[1] + low[1]) * self.counts[2] + low[2];
            found.push((number as u32, self.number));
            return;
        }
        let axis = (0..3).fold(0, |best, q| if sides[q] > sides[best] { q } else { best });
        let middle = low[axis] + sides[axis] / 2;
        let (mut below, mut above) = (high, low);
        (below[axis], above[axis]) = (middle, middle);
        self.descend(low, below, found);
        self.descend(above, high, found);
    }
}

/// Nodes within `far` of a triangle along an axis.
fn near(corners: &[[f64; 3]; 3], nodes: &Nodes, far: f64, axis: usize) -> std::ops::Range<usize> {
    let of = |start, choose: fn(f64, f64) -> f64| corners.iter().map(|p| p[axis]).fold(start, choose);
    nodes.between(
        axis,
        of(f64::INFINITY, f64::min) - far,
        of(f64::NEG_INFINITY, f64::max) + far,
    )
}

/// Lower a block's values to the distances from one triangle.
fn visit(corners: [[f64; 3]; 3], nodes: &Nodes, far: f64, place: &[u32; 3], values: &mut [f64]) {
    let triangle = Triangle::new(corners[0], corners[1], corners[2]);
    let [xs, ys, zs]: [_; 3] = std::array::from_fn(|q| {
        let (range, first) = (near(&corners, nodes, far, q), place[q] as usize * SIDE);
        range.start.max(first)..range.end.min(first + SIDE)
    });
    for i in xs {
        for j in ys.clone() {
            let row = ((i % SIDE) * SIDE + j % SIDE) * SIDE;
            for k in zs.clone() {
                let value = &mut values[row + k % SIDE];
                *value = triangle.nearer(nodes.point([i, j, k]), *value);
            }
        }
    }
}

fn place(block: usize, counts: [usize; 3]) -> [u32; 3] {
    let (rest, z) = (block / counts[2], block % counts[2]);
    [(rest / counts[1]) as u32, (rest % counts[1]) as u32, z as u32]
}
