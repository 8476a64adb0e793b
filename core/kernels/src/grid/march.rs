//! Distances away from nodes whose distances are known: fast marching of second order.
//!
//! Sethian, "Fast marching methods", SIAM Review 41 (1999), section 4.2: nodes are accepted in the order of their distances;
//! one-sided differences over two accepted nodes are of second order. Ties are broken by the nodes' numbers, so that the
//! result is always the same.

use std::cmp::Reverse;
use std::collections::BinaryHeap;

use super::region::Region;

/// Known distances are finite on entry; all others up to `limit` are found, the rest stays infinite.
pub fn march<const D: usize>(region: &Region<'_, D>, distances: &mut [f64], limit: f64) {
    let mut accepted: Vec<bool> = distances.iter().map(|d| d.is_finite()).collect();
    let mut heap = BinaryHeap::new();
    let offer = |k: usize, accepted: &[bool], distances: &mut [f64], heap: &mut BinaryHeap<_>| {
        let d = update(region, accepted, distances, k);
        if d < distances[k] {
            distances[k] = d;
            // Distances are positive: their bits are in their order.
            heap.push(Reverse((d.to_bits(), k)));
        }
    };
    let known: Vec<usize> = (0..accepted.len()).filter(|&k| accepted[k]).collect();
    for k in known {
        region.each_beside(k, |other| {
            if !accepted[other] && distances[other].is_infinite() {
                offer(other, &accepted, distances, &mut heap);
            }
        });
    }
    while let Some(Reverse((bits, k))) = heap.pop() {
        if accepted[k] || distances[k].to_bits() != bits {
            continue;
        }
        if distances[k] > limit {
            break;
        }
        accepted[k] = true;
        region.each_beside(k, |other| {
            if !accepted[other] {
                offer(other, &accepted, distances, &mut heap);
            }
        });
    }
    for (d, accepted) in distances.iter_mut().zip(accepted) {
        if !accepted {
            *d = f64::INFINITY;
        }
    }
}

/// The distance of a node by its accepted neighbours.
fn update<const D: usize>(region: &Region<'_, D>, accepted: &[bool], distances: &[f64], k: usize) -> f64 {
    // Terms weight * (d - base)^2 of |grad d|^2 = 1.
    let mut terms: [(f64, f64); D] = [(0.0, f64::INFINITY); D];
    let mut count = 0;
    for axis in 0..D {
        let mut nearest: Option<(usize, bool)> = None;
        for up in [false, true] {
            if let Some(other) = region.beside(k, axis, up).filter(|&other| accepted[other]) {
                if nearest.is_none_or(|(least, _)| distances[other] < distances[least]) {
                    nearest = Some((other, up));
                }
            }
        }
        let Some((one, up)) = nearest else {
            continue;
        };
        let h = region.spacing[axis];
        let two = region
            .beside(one, axis, up)
            .filter(|&two| accepted[two] && distances[two] <= distances[one]);
        terms[count] = match two {
            Some(two) => (
                2.25 / (h * h),
                (4.0 * distances[one] - distances[two]) * (1.0 / 3.0),
            ),
            None => (1.0 / (h * h), distances[one]),
        };
        count += 1;
    }
    solve(&mut terms[..count])
}

/// The largest root of sum weight (d - base)^2 = 1 that is not below a base that it uses.
fn solve(terms: &mut [(f64, f64)]) -> f64 {
    terms.sort_by(|a, b| a.1.total_cmp(&b.1));
    let mut d = f64::INFINITY;
    let (mut a, mut b, mut c) = (0.0, 0.0, -1.0);
    let origin = terms.first().map_or(0.0, |t| t.1);
    for &(weight, base) in terms.iter() {
        if base >= d {
            break;
        }
        // Bases relative to the least, so that squares of large numbers do not cancel.
        let base = base - origin;
        a += weight;
        b += weight * base;
        c += weight * base * base;
        let root = b * b - a * c;
        if root < 0.0 {
            break;
        }
        d = origin + (b + root.sqrt()) / a;
    }
    d
}
