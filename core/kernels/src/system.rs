//! One step of the evolution: the normal equations of E + omega S (TLS 3.9, 3.12, 3.15), filled and solved.

use rayon::prelude::*;

use crate::assembly::Worker;
use crate::bulk::evaluate;
use crate::cholesky::Factor;
use crate::conjugate;
use crate::dense::dots;
use crate::dissection::Dissection;
use crate::error::{KernelError, Result};
use crate::mesh::TMesh;
use crate::pattern::Pattern;

/// Iterations that an old factor may cost as a preconditioner: about what a new one costs.
const PATIENCE: usize = 16;
/// Iterations after which the rate so far tells whether the old factor will do.
const TRIAL: usize = 3;
/// Iterations with a fresh factor; two or three are the rule, more only make up for rounding.
const LIMIT: usize = 60;
/// Gradients shorter than this have no direction; their samples do not count.
pub(crate) const FLAT: f64 = 1e-6;

/// What the rates of one step have to fulfil, all in the unit box.
#[derive(Debug, Clone)]
pub struct Equations<'a, const D: usize> {
    pub coefficients: &'a [f64],
    /// Samples of the zero set, their shares of its length or area, and the normal speed wanted there.
    pub points: &'a [[f64; D]],
    pub weights: &'a [f64],
    pub speed: &'a [f64],
    /// Rows b . cdot = -v without the division by |grad f|: with c = 0 the plain least-squares fit of a field to values -v.
    pub plain: bool,
    /// Weight of -kappa in the speed, taken semi-implicitly over `time_step`.
    pub smoothing: Option<&'a [f64]>,
    pub time_step: f64,
    /// omega of (3.15) and 1/tau of MATH.md.
    pub constraint_weight: f64,
    pub relaxation: f64,
    /// Width, in element sides, of the band around the zero set outside which the constraint fades to `far_weight`.
    pub constraint_band: f64,
    pub far_weight: f64,
    /// Weight of the squared second derivatives of the field after the step, near the zero set.
    pub fairness: f64,
    /// Damping of the rates, relative to the mean diagonal entry.
    pub damping: f64,
    /// Relative residual at which the linear solve ends.
    pub tolerance: f64,
    /// Iterations with the diagonal as the preconditioner, before a factor is used: in space a factor costs as much as
    /// hundreds of them. 0: the factor at once.
    pub diagonal: usize,
}

/// The solution of one step and how it was reached.
#[derive(Debug, Clone)]
pub struct Rates {
    pub rates: Vec<f64>,
    /// Normal speed realised at the samples, -(b . cdot) / |grad f|.
    pub realised: Vec<f64>,
    /// Root mean square of |grad f| - 1 over the constraint's samples, in its weights.
    pub gradient_deviation: f64,
    pub iterations: usize,
    pub factorised: bool,
}

/// The normal equations of one mesh: pattern and elimination order made once, values refilled every step.
#[derive(Debug)]
pub struct System<const D: usize> {
    pattern: Pattern,
    /// Made for the first factor.
    dissection: Option<Dissection>,
    partial: Vec<f64>,
    lower: Vec<f64>,
    full: Vec<f64>,
    factor: Option<Factor>,
}

struct Buckets {
    start: Vec<usize>,
    sample: Vec<u32>,
}

impl<const D: usize> System<D> {
    pub fn new(mesh: &TMesh<D>) -> Result<Self> {
        let pattern = Pattern::new(mesh.elements(), mesh.num_functions())?;
        Ok(Self {
            partial: vec![0.0; pattern.partial_len()],
            lower: vec![0.0; pattern.lower_start[pattern.size()]],
            full: vec![0.0; pattern.columns.len()],
            factor: None,
            pattern,
            dissection: None,
        })
    }

    /// Entries of the matrix and of its factor.
    pub fn fill(&mut self, mesh: &TMesh<D>) -> (usize, usize) {
        let (entries, dissection) = (self.pattern.columns.len(), self.take_dissection(mesh));
        let fill = dissection.fill();
        self.dissection = Some(dissection);
        (entries, fill)
    }

    fn take_dissection(&mut self, mesh: &TMesh<D>) -> Dissection {
        let made = self.dissection.take();
        made.unwrap_or_else(|| Dissection::new(mesh.anchors(), &self.pattern))
    }

    /// Fill and solve. `warm` is a first guess of the rates.
    pub fn solve(&mut self, mesh: &TMesh<D>, eq: &Equations<'_, D>, warm: Option<&[f64]>) -> Result<Rates> {
        check(mesh, eq)?;
        let (mut rhs, gradient_deviation) = self.assemble(mesh, eq)?;
        let size = self.pattern.size();
        self.damp(eq.damping, size);
        self.pattern.mirror(&self.lower, &mut self.full);
        let mut rates = warm
            .filter(|w| w.len() == size)
            .map_or_else(|| vec![0.0; size], <[f64]>::to_vec);
        let (done, tried) = self.by_diagonal(&rhs, &mut rates, eq.tolerance, eq.diagonal);
        let (iterations, factorised) = if done {
            (tried, false)
        } else {
            let dissection = self.take_dissection(mesh);
            let solved = self.conjugate_gradients(&dissection, &mut rhs, &mut rates, eq.tolerance);
            self.dissection = Some(dissection);
            solved.map(|(more, factorised)| (tried + more, factorised))?
        };
        let flow = evaluate(mesh, &rates, eq.points, 0)?;
        let slope = evaluate(mesh, eq.coefficients, eq.points, 1)?;
        let realised = flow
            .values
            .iter()
            .zip(&slope.gradients)
            .map(|(u, g)| -u / norm(g).max(FLAT))
            .collect();
        Ok(Rates {
            rates,
            realised,
            gradient_deviation,
            iterations,
            factorised,
        })
    }

    /// The matrix of the last `solve`, as CSR: row starts, columns, values.
    pub fn matrix(&self) -> (&[usize], &[u32], &[f64]) {
        (&self.pattern.row_start, &self.pattern.columns, &self.full)
    }

    /// Fill the lower triangle; returns the right-hand side and the root mean square of |grad f| - 1.
    fn assemble(&mut self, mesh: &TMesh<D>, eq: &Equations<'_, D>) -> Result<(Vec<f64>, f64)> {
        let buckets = bucket(mesh, eq.points)?;
        let pattern = &self.pattern;
        let sums: Vec<[f64; 2]> = pattern
            .groups(&mut self.partial)
            .into_par_iter()
            .map_init(
                || Worker::new(mesh, eq),
                |worker, (elements, partial)| {
                    partial.fill(0.0);
                    let mut sum = [0.0; 2];
                    for e in elements {
                        let samples = &buckets.sample[buckets.start[e]..buckets.start[e + 1]];
                        let [s, w] = worker.element(e, samples, pattern.slots(e), partial);
                        sum[0] += s;
                        sum[1] += w;
                    }
                    sum
                },
            )
            .collect();
        let total = sums.iter().fold([0.0; 2], |t, s| [t[0] + s[0], t[1] + s[1]]);
        let mut rhs = vec![0.0; pattern.size()];
        pattern.gather(&self.partial, &mut self.lower, &mut rhs);
        Ok((rhs, (total[0] / total[1].max(f64::MIN_POSITIVE)).sqrt()))
    }

    /// Add the damping to the diagonal; it also keeps the matrix definite where neither E nor S reaches.
    fn damp(&mut self, damping: f64, size: usize) {
        let last = |i: usize| self.pattern.lower_start[i + 1] - 1;
        let mean = (0..size).map(|i| self.lower[last(i)]).sum::<f64>() / size as f64;
        for i in 0..size {
            let at = self.pattern.lower_start[i + 1] - 1;
            self.lower[at] += damping * mean;
        }
    }

    /// At most `limit` conjugate gradients, preconditioned by the diagonal; whether they reached the tolerance.
    fn by_diagonal(&self, rhs: &[f64], x: &mut [f64], tolerance: f64, limit: usize) -> (bool, usize) {
        if limit == 0 {
            return (false, 0);
        }
        let p = &self.pattern;
        let inverse: Vec<f64> = (0..p.size())
            .map(|i| 1.0 / self.lower[p.lower_start[i + 1] - 1].max(f64::MIN_POSITIVE))
            .collect();
        let size = |v: &[f64]| -> f64 {
            let squares = v.iter().zip(&inverse).map(|(v, i)| v * v * i);
            squares.sum::<f64>().sqrt()
        };
        let residual: Vec<f64> = self.multiply(x).iter().zip(rhs).map(|(q, b)| b - q).collect();
        let part = tolerance * size(rhs) / size(&residual).max(f64::MIN_POSITIVE);
        let multiply = |p: &[f64], q: &mut [f64]| self.multiply_into(p, q);
        let (change, iterations, done) =
            conjugate::conjugate_gradients(multiply, residual, &inverse, part, limit);
        for (x, change) in x.iter_mut().zip(change) {
            *x += change;
        }
        (done, iterations)
    }

    /// Conjugate gradients, preconditioned by the last factor; a new one is made when the old no longer serves.
    fn conjugate_gradients(
        &mut self,
        dissection: &Dissection,
        rhs: &mut [f64],
        x: &mut [f64],
        tolerance: f64,
    ) -> Result<(usize, bool)> {
        let target = tolerance * dot(rhs, rhs).sqrt();
        if target == 0.0 {
            x.fill(0.0);
            return Ok((0, false));
        }
        let mut total = 0;
        if let Some(factor) = self.factor.take() {
            let (done, iterations) = self.iterate((&factor, dissection), rhs, x, target, PATIENCE);
            total += iterations;
            if done {
                self.factor = Some(factor);
                return Ok((total, false));
            }
        }
        let factor = Factor::new(&self.pattern, dissection, &self.lower)?;
        let (done, iterations) = self.iterate((&factor, dissection), rhs, x, target, LIMIT);
        total += iterations;
        self.factor = Some(factor);
        if done {
            Ok((total, true))
        } else {
            Err(KernelError::NotSolved(format!(
                "the normal equations were not solved to {tolerance:e} in {total} iterations"
            )))
        }
    }

    fn iterate(
        &self,
        (factor, dissection): (&Factor, &Dissection),
        b: &[f64],
        x: &mut [f64],
        target: f64,
        limit: usize,
    ) -> (bool, usize) {
        let n = b.len();
        let mut r = self.multiply(x);
        for (r, b) in r.iter_mut().zip(b) {
            *r = b - *r;
        }
        let mut z = vec![0.0; n];
        let mut p = vec![0.0; n];
        let mut old = 0.0;
        let start = dot(&r, &r).sqrt();
        for iteration in 0..=limit {
            if dot(&r, &r).sqrt() <= target {
                return (true, iteration);
            }
            if iteration == limit
                || (limit == PATIENCE && hopeless(iteration, start, dot(&r, &r).sqrt(), target))
            {
                return (false, iteration);
            }
            factor.solve(dissection, &r, &mut z);
            let new = dot(&r, &z);
            let beta = if iteration == 0 { 0.0 } else { new / old };
            for (p, z) in p.iter_mut().zip(&z) {
                *p = z + beta * *p;
            }
            let q = self.multiply(&p);
            let alpha = new / dot(&p, &q);
            if !alpha.is_finite() {
                break;
            }
            for k in 0..n {
                x[k] += alpha * p[k];
                r[k] -= alpha * q[k];
            }
            old = new;
        }
        (false, limit)
    }

    fn multiply(&self, x: &[f64]) -> Vec<f64> {
        let mut q = vec![0.0; x.len()];
        self.multiply_into(x, &mut q);
        q
    }

    fn multiply_into(&self, x: &[f64], q: &mut [f64]) {
        let p = &self.pattern;
        q.par_iter_mut()
            .enumerate()
            .with_min_len(1024)
            .for_each(|(i, q)| {
                let range = p.row_start[i]..p.row_start[i + 1];
                *q = self.full[range.clone()]
                    .iter()
                    .zip(&p.columns[range])
                    .map(|(a, &j)| a * x[j as usize])
                    .sum();
            });
    }
}

pub(crate) fn norm<const D: usize>(v: &[f64; D]) -> f64 {
    v.iter().map(|x| x * x).sum::<f64>().sqrt()
}

/// Whether the residual, having come from `start` to `now`, will miss the target within the old factor's patience.
fn hopeless(iteration: usize, start: f64, now: f64, target: f64) -> bool {
    iteration >= TRIAL && (now / start).ln() * PATIENCE as f64 > (target / start).ln() * iteration as f64
}

fn dot(a: &[f64], b: &[f64]) -> f64 {
    dots([a], b)[0]
}

/// Samples by element.
fn bucket<const D: usize>(mesh: &TMesh<D>, points: &[[f64; D]]) -> Result<Buckets> {
    let elements = mesh.elements();
    let at: Vec<Option<usize>> = points
        .par_iter()
        .with_min_len(1024)
        .map(|x| elements.locate(mesh.tree(), x))
        .collect();
    let mut start = vec![0; elements.len() + 1];
    for (k, e) in at.iter().enumerate() {
        let e = e.ok_or_else(|| {
            KernelError::Invalid(format!("sample {k} at {:?} lies outside the box", points[k]))
        })?;
        start[e + 1] += 1;
    }
    for e in 0..elements.len() {
        start[e + 1] += start[e];
    }
    let mut fill = start.clone();
    let mut sample = vec![0; points.len()];
    for (k, e) in at.iter().flatten().enumerate() {
        sample[fill[*e]] = k as u32;
        fill[*e] += 1;
    }
    Ok(Buckets { start, sample })
}

fn check<const D: usize>(mesh: &TMesh<D>, eq: &Equations<'_, D>) -> Result<()> {
    mesh.check_coefficients(eq.coefficients)?;
    let m = eq.points.len();
    let lengths = [
        eq.weights.len(),
        eq.speed.len(),
        eq.smoothing.map_or(m, <[f64]>::len),
    ];
    if lengths.iter().any(|&l| l != m) {
        return Err(KernelError::Invalid(format!(
            "{m} samples, but weights, speed and smoothing have {lengths:?}"
        )));
    }
    let finite = |v: &[f64]| v.iter().all(|x| x.is_finite());
    if !finite(eq.weights) || !finite(eq.speed) || !eq.smoothing.is_none_or(finite) {
        return Err(KernelError::Invalid(
            "weights, speed and smoothing must be finite".into(),
        ));
    }
    if eq.weights.iter().any(|&w| w < 0.0) {
        return Err(KernelError::Invalid("weights must not be negative".into()));
    }
    if eq.smoothing.is_some_and(|s| s.iter().any(|&x| x < 0.0)) {
        return Err(KernelError::Invalid(
            "smoothing must not be negative: that would be backward diffusion".into(),
        ));
    }
    let scalars = [
        eq.time_step,
        eq.constraint_weight,
        eq.relaxation,
        eq.constraint_band,
        eq.far_weight,
        eq.fairness,
        eq.damping,
    ];
    if scalars.iter().any(|x| !x.is_finite() || *x < 0.0)
        || eq.constraint_band == 0.0
        || !(eq.tolerance > 0.0 && eq.tolerance.is_finite())
    {
        return Err(KernelError::Invalid(format!(
            "step parameters must be finite and not negative: {scalars:?}"
        )));
    }
    Ok(())
}
