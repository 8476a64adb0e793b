//! Distances by foot points on the interpolant's zero set, layer by layer of nodes away from it.
//!
//! Nodes beside a change of sign find their foot points by Newton steps; those of the next layers start from the foot
//! points of their neighbours, so that few steps are needed and the nearest part of the zero set is found.

use multiversion::multiversion;
use rayon::prelude::*;

use super::blocks::Blocks;
use super::interpolant::Interpolant;
use super::region::Region;
use crate::field::Field;

/// Nodes in one unit of parallel work.
const CHUNK: usize = 512;
/// Steps to a foot point; one or two are the rule.
const STEPS: usize = 12;
/// What is left of the way along the surface is less than this, in spacings: a foot point that is off by e puts the distance
/// off by e^2 / (2 d) only.
const LEFT: f64 = 1e-2;
/// By how much a step is shorter than the one before it, as long as there is one only: steps shrink by kappa d.
const SHRINK: f64 = 0.15;
/// Rounds in which nodes look whether a neighbour knows a nearer part.
const ROUNDS: usize = 8;
/// No foot point yet.
pub const NONE: u32 = u32::MAX;

/// Foot points, and the node of a region that each belongs to.
pub struct Feet<const D: usize> {
    /// Number of each node's foot point, or `NONE`.
    pub of_node: Vec<u32>,
    pub places: Vec<[f64; D]>,
    /// Distance of each foot point from its node.
    pub distances: Vec<f64>,
    nodes: Vec<usize>,
}

/// A node's place, and the way to the zero set from there.
struct Seed<const D: usize> {
    node: usize,
    foot: [f64; D],
}

/// Foot points of all nodes up to `limit` away; `values` are the interpolant's at the nodes `region.near`.
pub fn feet<const D: usize>(
    source: &Blocks<D>,
    region: &Region<'_, D>,
    values: &[f64],
    limit: f64,
) -> Feet<D> {
    let mut feet = Feet {
        of_node: vec![NONE; region.len()],
        places: Vec::new(),
        distances: Vec::new(),
        nodes: Vec::new(),
    };
    let mut found: Vec<Seed<D>> = region
        .near
        .par_chunks(CHUNK)
        .enumerate()
        .flat_map_iter(|(c, nodes)| {
            let mut out = Vec::new();
            begin(source, region, values, (c * CHUNK, nodes), &mut out);
            out
        })
        .collect();
    while !found.is_empty() {
        let from = feet.nodes.len();
        for seed in found {
            feet.of_node[seed.node] = feet.nodes.len() as u32;
            feet.distances
                .push(distance(&region.place(seed.node), &seed.foot));
            feet.nodes.push(seed.node);
            feet.places.push(seed.foot);
        }
        // Nodes without a foot point beside those of the last layer, each once.
        let mut next = Vec::new();
        for k in from..feet.nodes.len() {
            if feet.distances[k] > limit {
                continue;
            }
            region.each_beside(feet.nodes[k], |other| {
                if feet.of_node[other] == NONE {
                    feet.of_node[other] = NONE - 1;
                    next.push(other);
                }
            });
        }
        for &node in &next {
            feet.of_node[node] = NONE;
        }
        found = improve(source, region, &feet, &next, limit);
    }
    for _ in 0..ROUNDS {
        let better: Vec<usize> = feet
            .nodes
            .par_iter()
            .with_min_len(CHUNK)
            .filter(|&&node| {
                let own = feet.distances[feet.of_node[node] as usize];
                best(region, &feet, node).is_some_and(|(_, d)| d < own - 1e-9 * region.finest)
            })
            .copied()
            .collect();
        if better.is_empty() {
            break;
        }
        for seed in improve(source, region, &feet, &better, limit) {
            let k = feet.of_node[seed.node] as usize;
            feet.distances[k] = distance(&region.place(seed.node), &seed.foot);
            feet.places[k] = seed.foot;
        }
    }
    feet
}

/// Foot points of nodes that start from those of their neighbours.
fn improve<const D: usize>(
    source: &Blocks<D>,
    region: &Region<'_, D>,
    feet: &Feet<D>,
    nodes: &[usize],
    limit: f64,
) -> Vec<Seed<D>> {
    nodes
        .par_chunks(CHUNK)
        .flat_map_iter(|nodes| {
            let mut out = Vec::new();
            proceed(source, region, feet, nodes, limit, &mut out);
            out
        })
        .collect()
}

#[multiversion(targets("x86_64+avx+avx2"))]
fn begin<const D: usize>(
    source: &Blocks<D>,
    region: &Region<'_, D>,
    values: &[f64],
    (number, nodes): (usize, &[usize]),
    out: &mut Vec<Seed<D>>,
) {
    let mut field = Interpolant::new(source, &region.spacing);
    for (k, &node) in nodes.iter().enumerate() {
        if let Some(foot) = first(&mut field, region, values, node, values[number + k]) {
            out.push(Seed { node, foot });
        }
    }
}

#[multiversion(targets("x86_64+avx+avx2"))]
fn proceed<const D: usize>(
    source: &Blocks<D>,
    region: &Region<'_, D>,
    feet: &Feet<D>,
    nodes: &[usize],
    limit: f64,
    out: &mut Vec<Seed<D>>,
) {
    let mut field = Interpolant::new(source, &region.spacing);
    for &node in nodes {
        let Some((beside, bound)) = best(region, feet, node) else {
            continue;
        };
        let p = region.place(node);
        // The neighbour's foot point is not the nearest, but nearly: these nodes end the layers.
        if bound > limit + 0.5 * region.widest {
            out.push(Seed {
                node,
                foot: beside.foot,
            });
            continue;
        }
        let foot = beside
            .ahead
            .and_then(|start| settle(&mut field, region, &p, &start))
            .filter(|foot| distance(&p, foot) <= bound)
            .or_else(|| {
                settle(&mut field, region, &p, &beside.foot).filter(|foot| distance(&p, foot) <= bound)
            })
            // Where steps do not settle, at a ridge of the distance, the neighbour's foot point is on the zero set.
            .unwrap_or(beside.foot);
        out.push(Seed { node, foot });
    }
}

/// What the neighbours know of a node's foot point.
struct Beside<const D: usize> {
    /// The nearest of theirs.
    foot: [f64; D],
    /// Where the next one lies, as feet go on along a line of nodes.
    ahead: Option<[f64; D]>,
}

/// The nearest foot point of the neighbours, and its distance.
#[inline(always)]
fn best<const D: usize>(region: &Region<'_, D>, feet: &Feet<D>, node: usize) -> Option<(Beside<D>, f64)> {
    let p = region.place(node);
    let foot_of = |node: usize| feet.places.get(feet.of_node[node] as usize);
    let mut best: Option<([f64; D], f64, usize, (usize, bool))> = None;
    for axis in 0..D {
        for up in [false, true] {
            let Some(other) = region.beside(node, axis, up) else {
                continue;
            };
            if let Some(foot) = foot_of(other) {
                let d = distance(&p, foot);
                if best.is_none_or(|(_, least, ..)| d < least) {
                    best = Some((*foot, d, other, (axis, up)));
                }
            }
        }
    }
    let (foot, d, other, (axis, up)) = best?;
    let ahead = region
        .beside(other, axis, up)
        .and_then(foot_of)
        .map(|further| std::array::from_fn(|a| 2.0 * foot[a] - further[a]));
    Some((Beside { foot, ahead }, d))
}

/// The foot point of a node beside a change of sign; `None` for other nodes.
#[inline(always)]
fn first<const D: usize>(
    field: &mut Interpolant<'_, D>,
    region: &Region<'_, D>,
    values: &[f64],
    node: usize,
    f: f64,
) -> Option<[f64; D]> {
    let p = region.place(node);
    let mut nearest = f64::INFINITY;
    let mut crossing = p;
    // Distances along the axes to where f vanishes: the planes through these points are the fallback.
    let mut along = [f64::INFINITY; D];
    for a in 0..D {
        for up in [false, true] {
            let Some(other) = region.beside(node, a, up) else {
                continue;
            };
            let Some(&g) = values.get(region.number[other] as usize) else {
                continue;
            };
            if (g < 0.0) == (f < 0.0) {
                continue;
            }
            let d = f / (f - g) * region.spacing[a];
            along[a] = along[a].min(d);
            if d < nearest {
                nearest = d;
                crossing = p;
                crossing[a] += if up { d } else { -d };
            }
        }
    }
    if !nearest.is_finite() {
        return None;
    }
    let gradient = field.jet(&p).gradient;
    let square: f64 = gradient.iter().map(|g| g * g).sum();
    let newton: [f64; D] = std::array::from_fn(|a| p[a] - f * gradient[a] / square);
    // No crossing is nearer than the nearest point; they are linear guesses, though.
    let bound = 1.05 * nearest + 0.01 * region.finest;
    let good = |foot: &[f64; D]| distance(&p, foot) <= bound;
    let mut settled = None;
    if good(&newton) || distance(&p, &newton) <= 2.0 * region.widest {
        settled = settle(field, region, &p, &newton).filter(good);
    }
    if settled.is_none() {
        settled = settle(field, region, &p, &crossing).filter(good);
    }
    Some(settled.unwrap_or_else(|| {
        let inverse: f64 = along.iter().map(|d| 1.0 / (d * d).max(1e-300)).sum();
        let d = 1.0 / inverse.sqrt();
        let share = (d / nearest).min(1.0);
        std::array::from_fn(|a| p[a] + share * (crossing[a] - p[a]))
    }))
}

/// The foot point of `p` by steps from `start`: the nearest point of the tangent plane, again and again.
#[inline(always)]
fn settle<const D: usize>(
    field: &mut Interpolant<'_, D>,
    region: &Region<'_, D>,
    p: &[f64; D],
    start: &[f64; D],
) -> Option<[f64; D]> {
    let mut x = *start;
    let (mut damping, mut last) = (1.0, f64::INFINITY);
    for _ in 0..STEPS {
        let f = field.jet(&x);
        let square: f64 = f.gradient.iter().map(|g| g * g).sum();
        let along: f64 = (0..D).map(|a| f.gradient[a] * (p[a] - x[a])).sum();
        let mut length = 0.0;
        let mut step = [0.0; D];
        for a in 0..D {
            let tangential = p[a] - x[a] - f.gradient[a] * along / square;
            step[a] = damping * tangential - f.gradient[a] * f.value / square;
            length += step[a] * step[a];
        }
        length = length.sqrt();
        if !length.is_finite() {
            return None;
        }
        let shrink = if last.is_finite() { length / last } else { SHRINK };
        if shrink > 0.7 {
            damping *= 0.5;
        }
        let share = (region.widest / length.max(f64::MIN_POSITIVE)).min(1.0);
        // Of the step that is taken: one out of a flat place, where it is endless, would make any next one look small.
        last = share * length;
        for a in 0..D {
            x[a] = (x[a] + share * step[a]).clamp(0.0, region.high[a]);
        }
        // A geometric series of steps; those that hardly shrink tell nothing of the rest.
        if length * shrink.min(1.0) < LEFT * region.finest * (1.0 - shrink).max(0.1) {
            return Some(x);
        }
    }
    None
}

#[inline]
fn distance<const D: usize>(p: &[f64; D], q: &[f64; D]) -> f64 {
    (0..D).map(|a| (p[a] - q[a]).powi(2)).sum::<f64>().sqrt()
}
