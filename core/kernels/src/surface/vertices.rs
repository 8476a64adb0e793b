//! Vertices of the dual surface: one a loop, moved onto the zero set within its cube.

use multiversion::multiversion;
use rayon::prelude::*;

use super::lattice::{bits, place, Lattice};
use super::table::{ends, table};
use crate::evaluate::Jet;
use crate::field::Field;

/// Bricks in one unit of parallel work.
const CHUNK: usize = 32;
/// Newton steps; two or three are the rule.
const STEPS: usize = 8;
/// Distance from the zero set, in units of the box, that counts as none.
const REACHED: f64 = 1e-14;

/// A step this short, in sides of a cube, is the last one.
const LAST_STEP: f64 = 1e-7;

/// Where a vertex may be, and where its Newton steps start.
struct Site {
    low: [f64; 3],
    high: [f64; 3],
    /// Shortest side of a cube.
    side: f64,
    start: [f64; 3],
    /// Corners at the ends of the loop's edges, an outside and an inside one.
    ends: [[f64; 3]; 2],
    /// Outward normal of the box where the cube lies outside of it, else zero.
    wall: [f64; 3],
    /// Whether the zero set passes: cubes on a wall may be closed by the box alone.
    crossed: bool,
}

/// Positions in the box and unit normals, in the order of `Brick::first`.
pub fn vertices<F: Field<3>>(
    field: impl Fn() -> F + Sync + Send,
    lattice: &Lattice,
) -> (Vec<[f64; 3]>, Vec<[f64; 3]>) {
    let numbers: Vec<usize> = (0..lattice.bricks.len())
        .filter(|&b| lattice.bricks[b].active != 0)
        .collect();
    let parts: Vec<Vec<[[f64; 3]; 2]>> = numbers
        .par_chunks(CHUNK)
        .map_init(field, |field, numbers| vertices_of(field, lattice, numbers))
        .collect();
    parts.into_iter().flatten().map(|[x, n]| (x, n)).unzip()
}

#[multiversion(targets("x86_64+avx+avx2"))]
fn vertices_of<F: Field<3>>(field: &mut F, lattice: &Lattice, numbers: &[usize]) -> Vec<[[f64; 3]; 2]> {
    let mut out = Vec::new();
    for &b in numbers {
        sites(lattice, b, |site| out.push(settle(field, &site)));
    }
    out
}

/// Visit the loops of a brick's cubes.
#[inline(always)]
fn sites(lattice: &Lattice, b: usize, mut visit: impl FnMut(Site)) {
    let brick = &lattice.bricks[b];
    let around = lattice.around(b, 1);
    let n = lattice.n;
    let scale = lattice.side;
    let position =
        |p: [i32; 3]| -> [f64; 3] { std::array::from_fn(|a| f64::from(p[a].clamp(0, n[a])) * scale[a]) };
    for k in bits(brick.active) {
        let p = place(brick.corner, k);
        let node: [[i32; 3]; 8] =
            std::array::from_fn(|c| std::array::from_fn(|a| p[a] + (c >> a & 1) as i32));
        let in_box: [bool; 8] = node.map(|q| (0..3).all(|a| (0..=n[a]).contains(&q[a])));
        let values: [f64; 8] = std::array::from_fn(|c| value(lattice, &around, k, c));
        let places = node.map(position);
        let patches = table().patches(brick.cases[k], brick.turned >> k & 1 == 1);
        let (low, high) = (places[0], places[7]);
        let wall = std::array::from_fn(|a| f64::from(i8::from(p[a] >= n[a]) - i8::from(p[a] < 0)));
        for of in 0..patches.count {
            let edges = (0..12).filter(|&e| patches.of_edge[e] == of);
            let mut site = Site {
                low,
                high,
                side: scale[0].min(scale[1]).min(scale[2]),
                start: [0.0; 3],
                ends: [[0.0; 3]; 2],
                wall,
                crossed: false,
            };
            // Where the zero set passes a wall, only crossings on the wall tell where.
            let mut sums = [([0.0; 3], 0.0); 2];
            for e in edges {
                let [i, j] = ends(e);
                let t = crossing(values[i], values[j]);
                let real = in_box[i] && in_box[j];
                let (sum, weight) = &mut sums[usize::from(real)];
                for a in 0..3 {
                    sum[a] += places[i][a] + t * (places[j][a] - places[i][a]);
                }
                *weight += 1.0;
                if real {
                    site.crossed = true;
                    let inside = usize::from(brick.cases[k] >> i & 1 == 1);
                    site.ends[inside] = places[i];
                    site.ends[1 - inside] = places[j];
                }
            }
            let (sum, weight) = sums[usize::from(site.crossed)];
            for a in 0..3 {
                site.start[a] = (sum[a] / weight).clamp(low[a], high[a]);
            }
            visit(site);
        }
    }
}

/// Value at corner c of the k-th cube; beyond the box +infinity.
#[inline]
fn value(lattice: &Lattice, around: &[Option<usize>; 8], k: usize, c: usize) -> f64 {
    let (mut subset, mut bit) = (0, 0);
    for a in 0..3 {
        let x = (k >> (2 * a) & 3) + (c >> a & 1);
        subset |= (x >> 2) << a;
        bit |= (x & 3) << (2 * a);
    }
    around[subset].map_or(f64::INFINITY, |b| {
        let brick = &lattice.bricks[b];
        if brick.known >> bit & 1 == 1 {
            brick.values[bit]
        } else {
            f64::INFINITY
        }
    })
}

/// Where a linear function vanishes between 0 and 1; the middle if one value is infinite, of which only the sign is known.
#[inline]
fn crossing(a: f64, b: f64) -> f64 {
    let fall = a - b;
    if fall.is_finite() && fall.abs() > 0.0 {
        (a / fall).clamp(0.0, 1.0)
    } else {
        0.5
    }
}

/// The vertex and its normal.
#[inline(always)]
fn settle(field: &mut impl Field<3>, site: &Site) -> [[f64; 3]; 2] {
    if !site.crossed {
        return [site.start, unit(site.wall).unwrap_or([0.0; 3])];
    }
    let mut x = site.start;
    // Steps along the gradient, kept within the cube: a vertex in its own cube cannot turn its quads over.
    for _ in 0..STEPS {
        let f = field.jet(&x);
        let mut g = f.gradient;
        for a in 0..3 {
            let outward = (x[a] <= site.low[a] && f.value * g[a] > 0.0)
                || (x[a] >= site.high[a] && f.value * g[a] < 0.0);
            if outward || site.low[a] >= site.high[a] {
                g[a] = 0.0;
            }
        }
        let square = dot(&g, &g);
        if f.value.abs() <= REACHED * square.sqrt() {
            return [x, normal(&f, site)];
        }
        let step = f.value / square;
        if !step.is_finite() {
            break;
        }
        let mut free = true;
        for a in 0..3 {
            let to = x[a] - step * g[a];
            x[a] = to.clamp(site.low[a], site.high[a]);
            free &= site.low[a] <= to && to <= site.high[a];
        }
        // The error squares from step to step: after one this short it is rounding.
        if free && step.abs() * square.sqrt() < LAST_STEP * site.side {
            return [x, normal(&f, site)];
        }
    }
    let f = field.jet(&x);
    if f.value.abs() <= 1e-12 * dot(&f.gradient, &f.gradient).sqrt() {
        return [x, normal(&f, site)];
    }
    let x = bisect(field, site);
    let f = field.jet(&x);
    [x, normal(&f, site)]
}

#[inline(never)]
/// The zero between the start and the corner of the loop with the other sign.
fn bisect(field: &mut impl Field<3>, site: &Site) -> [f64; 3] {
    let inside = field.jet(&site.start).value < 0.0;
    let (from, to) = (site.start, site.ends[usize::from(!inside)]);
    let at = |t: f64| std::array::from_fn(|a| from[a] + t * (to[a] - from[a]));
    let (mut low, mut high) = (0.0, 1.0);
    for _ in 0..50 {
        let middle = 0.5 * (low + high);
        if (field.jet(&at(middle)).value < 0.0) == inside {
            low = middle;
        } else {
            high = middle;
        }
    }
    at(0.5 * (low + high))
}

/// The field's normal; on the rim, where the box cuts the shape, halfway between it and the wall's.
fn normal(f: &Jet<3>, site: &Site) -> [f64; 3] {
    let n = unit(f.gradient).unwrap_or([0.0; 3]);
    unit(std::array::from_fn(|a| n[a] + site.wall[a])).unwrap_or([0.0; 3])
}

#[inline]
fn dot(p: &[f64; 3], q: &[f64; 3]) -> f64 {
    p[0] * q[0] + p[1] * q[1] + p[2] * q[2]
}

/// `None` for a vector without direction.
fn unit(v: [f64; 3]) -> Option<[f64; 3]> {
    let length = dot(&v, &v).sqrt();
    (length > 0.0 && length.is_finite()).then(|| v.map(|x| x / length))
}
