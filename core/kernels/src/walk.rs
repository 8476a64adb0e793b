//! Which tetrahedron of a Delaunay triangulation holds a point.

use rayon::prelude::*;

use crate::error::{KernelError, Result};

/// Points of a chunk: each starts where the one before ended, so that neighbouring points need few steps.
const CHUNK: usize = 512;

/// Facets of a tetrahedron by their corners, opposite to corner 0, 1, 2, 3.
const FACETS: [[usize; 3]; 4] = [[1, 2, 3], [0, 2, 3], [0, 1, 3], [0, 1, 2]];

/// The cell that holds each query, -1 outside of the hull: walks across the facets that a query lies beyond.
pub fn locate(
    points: &[[f64; 3]],
    cells: &[[i32; 4]],
    neighbours: &[[i32; 4]],
    queries: &[[f64; 3]],
) -> Result<Vec<i32>> {
    let bad = |list: &[[i32; 4]], low: i32, high: usize| {
        list.iter().flatten().any(|&v| v < low || v >= high as i32)
    };
    if cells.is_empty()
        || cells.len() != neighbours.len()
        || bad(cells, 0, points.len())
        || bad(neighbours, -1, cells.len())
    {
        return Err(KernelError::Invalid(
            "cells: numbers that are no sample's or no cell's".into(),
        ));
    }
    Ok(queries
        .par_chunks(CHUNK)
        .flat_map_iter(|chunk| {
            let mut at = 0;
            chunk.iter().map(move |query| {
                let (last, inside) = walk(points, cells, neighbours, query, at);
                at = last;
                if inside {
                    last as i32
                } else {
                    -1
                }
            })
        })
        .collect())
}

/// The cell where the walk ends, and whether it holds the query.
fn walk(
    points: &[[f64; 3]],
    cells: &[[i32; 4]],
    neighbours: &[[i32; 4]],
    query: &[f64; 3],
    start: usize,
) -> (usize, bool) {
    let mut at = start;
    // Delaunay walks end; rounding at flat cells could turn one round for ever.
    for step in 0..2 * cells.len() {
        let corner = cells[at].map(|v| &points[v as usize]);
        let beyond = (0..4).map(|f| (f + step) % 4).find(|&f| {
            let [a, b, c] = FACETS[f].map(|q| corner[q]);
            let side = volume(a, b, c, query);
            side != 0.0 && (side > 0.0) != (volume(a, b, c, corner[f]) > 0.0)
        });
        match beyond {
            None => return (at, true),
            Some(f) if neighbours[at][f] < 0 => return (at, false),
            Some(f) => at = neighbours[at][f] as usize,
        }
    }
    (at, true)
}

/// Six times the signed volume of the tetrahedron a, b, c, d.
fn volume(a: &[f64; 3], b: &[f64; 3], c: &[f64; 3], d: &[f64; 3]) -> f64 {
    let [u, v, w] = [b, c, d].map(|p| [p[0] - a[0], p[1] - a[1], p[2] - a[2]]);
    u[0] * (v[1] * w[2] - v[2] * w[1]) - u[1] * (v[0] * w[2] - v[2] * w[0])
        + u[2] * (v[0] * w[1] - v[1] * w[0])
}
