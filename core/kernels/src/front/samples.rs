//! Samples of the zero set: one an active node, where its normal meets the zero set.

use rayon::prelude::*;

use super::mask::offsets;
use super::upwind::Stencil;
use super::Front;
use crate::grid::Blocks;

/// |grad f| below this is taken as this: there f is no distance, and the foot point would be thrown far away.
const FLAT: f64 = 0.5;

/// Samples in the order of the active nodes; lengths in the caller's units, places measured from node 0.
#[derive(Debug, Clone, Default)]
pub struct Samples<const D: usize> {
    pub points: Vec<[f64; D]>,
    pub normals: Vec<[f64; D]>,
    pub gradient_norm: Vec<f64>,
    /// Shares of length or area: a cell's volume spread over the active layer's width.
    pub weights: Vec<f64>,
}

impl<const D: usize> Front<D> {
    /// Samples of the zero set; during a step, after its first stage, those of the stage.
    pub fn samples(&self, staged: bool) -> Samples<D> {
        let n = self.len();
        let mut out = Samples {
            points: vec![[0.0; D]; n],
            normals: vec![[0.0; D]; n],
            gradient_norm: vec![0.0; n],
            weights: vec![0.0; n],
        };
        let stencil = self.stencil(staged);
        let share = self.spacing.iter().product::<f64>() / (2.0 * self.half);
        let parts = (
            split(&mut out.points, &self.first),
            split(&mut out.normals, &self.first),
            split(&mut out.gradient_norm, &self.first),
            split(&mut out.weights, &self.first),
        );
        (parts.0, parts.1, parts.2, parts.3)
            .into_par_iter()
            .enumerate()
            .for_each(|(slot, (points, normals, norms, weights))| {
                let place = &self.blocks.places()[slot];
                for (k, offset) in offsets(self.active(slot)).enumerate() {
                    let node = Blocks::<D>::node(place, offset);
                    let f = stencil.values[slot * Blocks::<D>::VOLUME + offset];
                    let g = stencil.gradient(slot, offset);
                    let norm = g.iter().map(|x| x * x).sum::<f64>().sqrt();
                    let steep = norm.max(FLAT);
                    norms[k] = norm;
                    weights[k] = share * norm;
                    for a in 0..D {
                        let n = g[a] / norm.max(f64::MIN_POSITIVE);
                        normals[k][a] = n;
                        points[k][a] = node[a] as f64 * self.spacing[a] - n * f / steep;
                    }
                }
            });
        out
    }

    /// kappa = k1 + k2 at the samples, by central differences.
    pub fn curvatures(&self, staged: bool) -> Vec<f64> {
        let stencil = self.stencil(staged);
        self.at_active(|slot, offset| {
            let f = stencil.values[slot * Blocks::<D>::VOLUME + offset];
            let derivatives = stencil.derivatives(slot, offset);
            derivatives.curvature_at_zero(f / derivatives.square().sqrt().max(FLAT))
        })
    }

    /// Principal curvatures at the samples, larger first (in the plane the second one is 0), by differences of normals.
    pub fn principal_curvatures(&self, staged: bool) -> Vec<[f64; 2]> {
        let stencil = self.stencil(staged);
        self.at_active(|slot, offset| {
            let f = stencil.values[slot * Blocks::<D>::VOLUME + offset];
            let (k, norm) = stencil.principal(slot, offset);
            let distance = f / norm.max(FLAT);
            k.map(|k| {
                let denominator = 1.0 - distance * k;
                if denominator < 0.25 {
                    k
                } else {
                    k / denominator
                }
            })
        })
    }

    /// One value an active node.
    pub(super) fn at_active<T: Send + Clone + Default>(
        &self,
        value: impl Fn(usize, usize) -> T + Sync,
    ) -> Vec<T> {
        let mut out = vec![T::default(); self.len()];
        split(&mut out, &self.first)
            .into_par_iter()
            .enumerate()
            .for_each(|(slot, part)| {
                for (to, offset) in part.iter_mut().zip(offsets(self.active(slot))) {
                    *to = value(slot, offset);
                }
            });
        out
    }

    pub(super) fn stencil(&self, staged: bool) -> Stencil<'_, D> {
        Stencil {
            blocks: &self.blocks,
            values: if staged { &self.work } else { self.blocks.values() },
            spacing: &self.spacing,
        }
    }
}

/// The parts of a list that belong to each slot.
pub(super) fn split<'a, T>(mut list: &'a mut [T], first: &[usize]) -> Vec<&'a mut [T]> {
    first
        .windows(2)
        .map(|w| {
            let (part, rest) = std::mem::take(&mut list).split_at_mut(w[1] - w[0]);
            list = rest;
            part
        })
        .collect()
}
