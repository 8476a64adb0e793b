//! A planar triangulation near the zero set of a field, and the closed lines through it.

use rustc_hash::FxHashMap;

/// A corner of the triangulation, in whole units of its lattice.
pub type Node = [u32; 2];
/// A side of a triangle by the numbers of its ends, smaller node first.
pub type Edge = (u32, u32);

/// Nodes, the field's values there, and triangles by node numbers, counter-clockwise.
pub struct Net {
    pub nodes: Vec<Node>,
    pub values: Vec<f64>,
    /// The first corner of a triangle is a square's centre; the other two lie on the square's side.
    pub triangles: Vec<[u32; 3]>,
    /// Upper corner of the box in units of the lattice.
    pub end: Node,
}

/// Closed polylines one after another, inside (f < 0) on the left: `vertices[start[k]..start[k + 1]]` is the k-th.
#[derive(Debug, Clone, Default)]
pub struct Loops {
    pub start: Vec<usize>,
    pub vertices: Vec<[f64; 2]>,
}

/// Edges that the zero set crosses, each with the one that follows it along the line; a node of the box's border that
/// is inside is an edge of length zero.
pub fn crossings(net: &Net) -> (Vec<Edge>, Vec<usize>) {
    let mut number: FxHashMap<Edge, usize> = FxHashMap::default();
    let mut edges = Vec::new();
    let mut next = Vec::new();
    let mut index = |a: u32, b: u32, next: &mut Vec<usize>| {
        let edge = if net.nodes[a as usize] < net.nodes[b as usize] {
            (a, b)
        } else {
            (b, a)
        };
        *number.entry(edge).or_insert_with(|| {
            edges.push(edge);
            next.push(usize::MAX);
            edges.len() - 1
        })
    };
    for t in &net.triangles {
        let inside = t.map(|n| net.values[n as usize] < 0.0);
        // The border closes the shape: what of a side on it is inside belongs to the line.
        let (a, b) = (t[1], t[2]);
        let [p, q] = [a, b].map(|n| net.nodes[n as usize]);
        let on_border = (0..2).any(|k| p[k] == q[k] && (p[k] == 0 || p[k] == net.end[k]));
        if on_border && (inside[1] || inside[2]) {
            let from = if inside[1] {
                index(a, a, &mut next)
            } else {
                index(a, b, &mut next)
            };
            let to = if inside[2] {
                index(b, b, &mut next)
            } else {
                index(a, b, &mut next)
            };
            next[from] = to;
        }
        let count = inside.iter().filter(|&&i| i).count();
        if count == 0 || count == 3 {
            continue;
        }
        // The corner that stands alone, then counter-clockwise; zero counts as outside.
        let lone = (0..3).find(|&k| inside[k] == (count == 1)).unwrap_or(0);
        let (p, q, r) = (t[lone], t[(lone + 1) % 3], t[(lone + 2) % 3]);
        let (first, second) = (index(p, q, &mut next), index(p, r, &mut next));
        let (from, to) = if count == 1 {
            (first, second)
        } else {
            (second, first)
        };
        next[from] = to;
    }
    (edges, next)
}

/// The zero between two places by the Illinois variant of regula falsi.
pub fn illinois(a: [f64; 2], b: [f64; 2], values: [f64; 2], mut f: impl FnMut(&[f64; 2]) -> f64) -> [f64; 2] {
    let (mut lo, mut hi) = (0.0, 1.0);
    let [mut f_lo, mut f_hi] = values;
    let at = |t: f64| [a[0] + t * (b[0] - a[0]), a[1] + t * (b[1] - a[1])];
    // What rounding leaves of a sum of cubics; values are in the caller's units, so that no fixed bound would do.
    let zero = 1e-16 * f_lo.abs().max(f_hi.abs());
    let mut t = 0.5;
    let mut last = 0_i8;
    for _ in 0..60 {
        t = if f_hi - f_lo == 0.0 {
            0.5 * (lo + hi)
        } else {
            (lo * f_hi - hi * f_lo) / (f_hi - f_lo)
        };
        let value = f(&at(t));
        if value.abs() <= zero {
            break;
        }
        // The end that stays is weighed down only when it stays twice: halved at every step, convergence is linear.
        if (value < 0.0) == (f_lo < 0.0) {
            (lo, f_lo) = (t, value);
            if last == -1 {
                f_hi *= 0.5;
            }
            last = -1;
        } else {
            (hi, f_hi) = (t, value);
            if last == 1 {
                f_lo *= 0.5;
            }
            last = 1;
        }
        if hi - lo < 1e-15 {
            break;
        }
    }
    at(t)
}

/// Join crossings to closed lines; those that are nearer than `rounding` are one.
pub fn chain(points: &[[f64; 2]], next: &[usize], rounding: f64) -> Loops {
    let meet = |p: &[f64; 2], q: &[f64; 2]| (p[0] - q[0]).abs().max((p[1] - q[1]).abs()) < rounding;
    let mut loops = Loops {
        start: vec![0],
        vertices: Vec::with_capacity(points.len()),
    };
    let mut done = vec![false; points.len()];
    for begin in 0..points.len() {
        if done[begin] {
            continue;
        }
        let first = loops.vertices.len();
        let mut k = begin;
        while k != usize::MAX && !done[k] {
            done[k] = true;
            let p = points[k];
            // Crossings at one place (a zero on a node) would make sides of length zero.
            if loops.vertices.len() == first || !loops.vertices.last().is_some_and(|q| meet(q, &p)) {
                loops.vertices.push(p);
            }
            k = next[k];
        }
        if loops.vertices.len() > first + 1
            && loops
                .vertices
                .last()
                .is_some_and(|q| meet(q, &loops.vertices[first]))
        {
            loops.vertices.pop();
        }
        if loops.vertices.len() >= first + 3 {
            loops.start.push(loops.vertices.len());
        } else {
            loops.vertices.truncate(first);
        }
    }
    loops
}
