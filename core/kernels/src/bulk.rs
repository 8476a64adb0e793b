//! Values, gradients and Hessians of a rational T-spline at many points at once.

use rayon::prelude::*;

use crate::error::Result;
use crate::evaluate::{Jet, CHUNK};
use crate::mesh::TMesh;
use crate::polynomial::Quotient;

/// A field at many points; what was not asked for is empty.
#[derive(Debug, Clone, Default)]
pub struct Field<const D: usize> {
    pub values: Vec<f64>,
    pub gradients: Vec<[f64; D]>,
    pub hessians: Vec<[[f64; D]; D]>,
}

/// What one point takes while the points are in the order of their elements: no larger than was asked for, as moving
/// these records is a good part of the work.
trait Record<const D: usize>: Copy + Send + Sync {
    const OUTSIDE: Self;
    fn new(q: &Quotient<D>, x: &[f64; D]) -> Self;
    fn store(&self, value: &mut f64, gradient: Option<&mut [f64; D]>, hessian: Option<&mut [[f64; D]; D]>);
}

impl<const D: usize> Record<D> for f64 {
    const OUTSIDE: Self = Self::INFINITY;

    #[inline(always)]
    fn new(q: &Quotient<D>, x: &[f64; D]) -> Self {
        q.at::<0>(x).value
    }

    #[inline(always)]
    fn store(&self, value: &mut f64, _: Option<&mut [f64; D]>, _: Option<&mut [[f64; D]; D]>) {
        *value = *self;
    }
}

#[derive(Clone, Copy)]
struct Slope<const D: usize> {
    value: f64,
    gradient: [f64; D],
}

impl<const D: usize> Record<D> for Slope<D> {
    const OUTSIDE: Self = Self {
        value: f64::INFINITY,
        gradient: [f64::NAN; D],
    };

    #[inline(always)]
    fn new(q: &Quotient<D>, x: &[f64; D]) -> Self {
        let jet = q.at::<1>(x);
        Self {
            value: jet.value,
            gradient: jet.gradient,
        }
    }

    #[inline(always)]
    fn store(&self, value: &mut f64, gradient: Option<&mut [f64; D]>, _: Option<&mut [[f64; D]; D]>) {
        *value = self.value;
        if let Some(g) = gradient {
            *g = self.gradient;
        }
    }
}

impl<const D: usize> Record<D> for Jet<D> {
    const OUTSIDE: Self = Jet::OUTSIDE;

    #[inline(always)]
    fn new(q: &Quotient<D>, x: &[f64; D]) -> Self {
        q.at::<2>(x)
    }

    #[inline(always)]
    fn store(&self, value: &mut f64, gradient: Option<&mut [f64; D]>, hessian: Option<&mut [[f64; D]; D]>) {
        *value = self.value;
        if let Some(g) = gradient {
            *g = self.gradient;
        }
        if let Some(h) = hessian {
            *h = self.hessian;
        }
    }
}

/// The field at many points with derivatives up to `order` (0, 1 or 2); outside the box +infinity and NaN.
pub fn evaluate<const D: usize>(
    mesh: &TMesh<D>,
    c: &[f64],
    points: &[[f64; D]],
    order: usize,
) -> Result<Field<D>> {
    mesh.check_coefficients(c)?;
    Ok(match order {
        0 => evaluate_as::<D, f64>(mesh, c, points, 0),
        1 => evaluate_as::<D, Slope<D>>(mesh, c, points, 1),
        _ => evaluate_as::<D, Jet<D>>(mesh, c, points, 2),
    })
}

/// Points are copied into the order of their elements, so that each element's polynomials are made once and everything
/// but these copies streams. A value depends on its own point alone, not on its neighbours in the call.
fn evaluate_as<const D: usize, R: Record<D>>(
    mesh: &TMesh<D>,
    c: &[f64],
    points: &[[f64; D]],
    order: usize,
) -> Field<D> {
    let n = points.len();
    let mut field = Field {
        values: vec![0.0; n],
        gradients: vec![[0.0; D]; if order >= 1 { n } else { 0 }],
        hessians: vec![[[0.0; D]; D]; if order >= 2 { n } else { 0 }],
    };
    // Enough points to share the elements' polynomials, few enough that work space is used again while it is in the cache.
    let block = (8 * mesh.elements().len()).max(1 << 16);
    let (mut sorted, mut records) = (Sorted::default(), Vec::<R>::new());
    let mut values = field.values.chunks_mut(block);
    let mut gradients = field.gradients.chunks_mut(block);
    let mut hessians = field.hessians.chunks_mut(block);
    for points in points.chunks(block) {
        sorted.refill(mesh, points);
        fill_records(mesh, c, &sorted, &mut records);
        let out = (
            values.next().unwrap_or(&mut []),
            gradients.next().unwrap_or(&mut []),
            hessians.next().unwrap_or(&mut []),
        );
        unsort(&records, &sorted.place, out);
    }
    field
}

fn fill_records<const D: usize, R: Record<D>>(
    mesh: &TMesh<D>,
    c: &[f64],
    sorted: &Sorted<D>,
    records: &mut Vec<R>,
) {
    records.resize(sorted.points.len(), R::OUTSIDE);
    records
        .par_chunks_mut(CHUNK)
        .enumerate()
        .for_each_init(Quotient::new, |quotient, (chunk, out)| {
            let begin = CHUNK * chunk;
            let mut run = sorted.run_of(begin);
            let mut k = 0;
            while k < out.len() {
                let (element, end) = sorted.runs[run];
                let end = (end as usize - begin).min(out.len());
                quotient.load(mesh.elements(), element as usize, c);
                for (record, x) in out[k..end].iter_mut().zip(&sorted.points[begin + k..begin + end]) {
                    *record = R::new(quotient, x);
                }
                k = end;
                run += 1;
            }
        });
}

/// Points in the order of their elements.
#[derive(Default)]
struct Sorted<const D: usize> {
    points: Vec<[f64; D]>,
    /// Where each point of the caller went; beyond the sorted ones if it lies outside.
    place: Vec<u32>,
    /// Elements that hold points, and where the points of each end.
    runs: Vec<(u32, u32)>,
    /// Work space: the points' elements, and the next free place of each element.
    at: Vec<u32>,
    fill: Vec<u32>,
}

impl<const D: usize> Sorted<D> {
    /// Sort by counting.
    fn refill(&mut self, mesh: &TMesh<D>, points: &[[f64; D]]) {
        let elements = mesh.elements();
        let outside = elements.len() as u32;
        self.at.resize(points.len(), 0);
        self.at
            .par_chunks_mut(CHUNK)
            .zip(points.par_chunks(CHUNK))
            .for_each(|(out, xs)| {
                for (e, x) in out.iter_mut().zip(xs) {
                    *e = elements.locate(mesh.tree(), x).map_or(outside, |e| e as u32);
                }
            });
        self.fill.clear();
        self.fill.resize(elements.len() + 1, 0);
        for &e in &self.at {
            self.fill[e as usize] += 1;
        }
        self.runs.clear();
        let mut sum = 0;
        for (e, slot) in self.fill.iter_mut().enumerate() {
            let count = std::mem::replace(slot, sum);
            sum += count;
            if count > 0 && e < elements.len() {
                self.runs.push((e as u32, sum));
            }
        }
        self.points
            .resize(self.runs.last().map_or(0, |r| r.1 as usize), [0.0; D]);
        self.place.clear();
        self.place.reserve(points.len());
        for (&e, x) in self.at.iter().zip(points) {
            let slot = &mut self.fill[e as usize];
            if let Some(p) = self.points.get_mut(*slot as usize) {
                *p = *x;
            }
            self.place.push(*slot);
            *slot += 1;
        }
    }

    /// The run that holds the k-th sorted point.
    fn run_of(&self, k: usize) -> usize {
        self.runs.partition_point(|r| r.1 as usize <= k)
    }
}

type Parts<'a, const D: usize> = (&'a mut [f64], &'a mut [[f64; D]], &'a mut [[[f64; D]; D]]);

/// Records back in the caller's order, taken apart.
fn unsort<const D: usize, R: Record<D>>(records: &[R], place: &[u32], out: Parts<'_, D>) {
    let (values, gradients, hessians) = out;
    let mut gradients = gradients.chunks_mut(CHUNK);
    let mut hessians = hessians.chunks_mut(CHUNK);
    let tasks: Vec<_> = place
        .chunks(CHUNK)
        .zip(values.chunks_mut(CHUNK))
        .map(|(place, v)| {
            (
                place,
                v,
                gradients.next().unwrap_or(&mut []),
                hessians.next().unwrap_or(&mut []),
            )
        })
        .collect();
    tasks
        .into_par_iter()
        .for_each(|(place, values, gradients, hessians)| {
            for (k, (&at, value)) in place.iter().zip(values).enumerate() {
                records.get(at as usize).unwrap_or(&R::OUTSIDE).store(
                    value,
                    gradients.get_mut(k),
                    hessians.get_mut(k),
                );
            }
        });
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::evaluate::{field_at, Scratch};
    use crate::refine::from_points;

    #[test]
    fn constants_are_reproduced_with_zero_derivatives() {
        let mesh = TMesh::<2>::uniform(3).unwrap();
        let c = vec![2.5; mesh.num_functions()];
        let points = [[0.0, 0.0], [1.0, 1.0], [0.3, 0.71], [0.5, 0.125]];
        let field = evaluate(&mesh, &c, &points, 2).unwrap();
        assert!(field.values.iter().all(|v| (v - 2.5).abs() < 1e-14));
        assert!(field.gradients.iter().flatten().all(|g| g.abs() < 1e-12));
    }

    #[test]
    fn outside_is_plus_infinity() {
        let mesh = TMesh::<2>::uniform(1).unwrap();
        let c = vec![1.0; mesh.num_functions()];
        let field = evaluate(&mesh, &c, &[[1.5, 0.5], [0.2, 0.3], [f64::NAN, 0.5]], 1).unwrap();
        assert!(field.values[0] == f64::INFINITY && field.values[2] == f64::INFINITY);
        assert!(field.gradients[0][0].is_nan() && field.gradients[2][1].is_nan());
        assert!((field.values[1] - 1.0).abs() < 1e-15 && field.hessians.is_empty());
    }

    fn agrees_with_single_points<const D: usize>(mesh: &TMesh<D>) {
        let c: Vec<f64> = (0..mesh.num_functions())
            .map(|i| (i as f64 * 0.7).sin())
            .collect();
        let points: Vec<[f64; D]> = (0..3000)
            .map(|k| std::array::from_fn(|a| (f64::from(k) * [0.618_034, 0.754_878, 0.569_840][a]).fract()))
            .collect();
        let field = evaluate(mesh, &c, &points, 2).unwrap();
        let slopes = evaluate(mesh, &c, &points, 1).unwrap();
        assert_eq!(field.values, slopes.values);
        assert_eq!(field.gradients, slopes.gradients);
        let mut scratch = Scratch::new();
        // Derivatives grow by 1/h each, and so does their rounding.
        let scale = f64::from(1_u32 << mesh.depth());
        for (k, x) in points.iter().enumerate() {
            let jet = field_at::<D, 2>(mesh, &mut scratch, &c, x);
            assert!((jet.value - field.values[k]).abs() < 1e-13);
            for a in 0..D {
                assert!((jet.gradient[a] - field.gradients[k][a]).abs() < 1e-13 * scale);
                for b in 0..D {
                    assert!((jet.hessian[a][b] - field.hessians[k][a][b]).abs() < 1e-12 * scale * scale);
                }
            }
        }
    }

    #[test]
    fn polynomials_and_basis_functions_agree() {
        agrees_with_single_points(&from_points(&[[0.31, 0.62], [0.8, 0.2]], &[6, 5], 1, 2, 100_000).unwrap());
        agrees_with_single_points(&from_points(&[[0.31, 0.62, 0.4]], &[4], 1, 1, 100_000).unwrap());
    }
}
