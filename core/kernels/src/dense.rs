//! Dense kernels of the factorisation and the assembly, written so that the compiler makes vectors of their loops.
//!
//! Matrices are column-major, a column's stride is the number of rows. The entry points are compiled for several
//! generations of processors, and chosen among at run time; as multiplications and additions are never fused, and sums
//! are split by the source alone, all of them give the same bits.

use multiversion::multiversion;

/// Columns that are eliminated before the rest is updated.
const PANEL: usize = 32;
/// Rows and columns of the block that is updated in registers.
const TALL: usize = 8;
const WIDE: usize = 4;

/// Eliminate the first `c` columns of the lower triangle of an `m` by `m` matrix; the rest becomes the Schur complement.
/// `Err(k)`: pivot k is not positive.
#[multiversion(targets("x86_64+avx+avx2"))]
pub fn partial_cholesky(a: &mut [f64], m: usize, c: usize) -> Result<(), usize> {
    let mut k = 0;
    while k < c {
        let width = PANEL.min(c - k);
        eliminate(&mut a[k * m..(k + width) * m], m, k)?;
        let (done, rest) = a.split_at_mut((k + width) * m);
        update(&done[k * m..], rest, m, k + width);
        k += width;
    }
    Ok(())
}

/// Cholesky elimination within a panel whose first column is column `k` of its matrix.
#[inline(always)]
fn eliminate(panel: &mut [f64], m: usize, k: usize) -> Result<(), usize> {
    for p in 0..panel.len() / m {
        let (before, current) = panel.split_at_mut(p * m);
        let column = &mut current[k + p..m];
        let mut q = 0;
        while q + 4 <= p {
            let l: [&[f64]; 4] = std::array::from_fn(|s| &before[(q + s) * m + k + p..(q + s + 1) * m]);
            let f = l.map(|l| -l[0]);
            add_four(column, l, f);
            q += 4;
        }
        for other in before[q * m..].chunks_exact(m) {
            add_one(column, &other[k + p..], -other[k + p]);
        }
        let pivot = column[0];
        if pivot.is_nan() || pivot <= 0.0 {
            return Err(k + p);
        }
        let inverse = 1.0 / pivot.sqrt();
        for v in column.iter_mut() {
            *v *= inverse;
        }
    }
    Ok(())
}

/// Subtract panel * panel^T from the lower triangle of the columns `rest`, the first of which is column `j0`.
#[inline(always)]
fn update(panel: &[f64], rest: &mut [f64], m: usize, j0: usize) {
    for (t, columns) in rest.chunks_mut(WIDE * m).enumerate() {
        let j = j0 + WIDE * t;
        let wide = columns.len() / m;
        let mut i = j;
        if wide == WIDE {
            while i + TALL <= m {
                block(panel, columns, m, i, j);
                i += TALL;
            }
        }
        // What is left of a full set of columns, or all of the last few.
        for (s, column) in columns.chunks_exact_mut(m).enumerate() {
            let first = i.max(j + s);
            for l in panel.chunks_exact(m) {
                add_one(&mut column[first..], &l[first..], -l[j + s]);
            }
        }
    }
}

/// The block of `TALL` rows from `i` and `WIDE` columns from `j`; above the diagonal it writes what nobody reads.
#[inline(always)]
fn block(panel: &[f64], columns: &mut [f64], m: usize, i: usize, j: usize) {
    let mut sum = [[0.0; TALL]; WIDE];
    for l in panel.chunks_exact(m) {
        let (rows, factors) = (&l[i..i + TALL], &l[j..j + WIDE]);
        for s in 0..WIDE {
            for r in 0..TALL {
                sum[s][r] += factors[s] * rows[r];
            }
        }
    }
    for s in 0..WIDE {
        for (v, x) in columns[s * m + i..s * m + i + TALL].iter_mut().zip(&sum[s]) {
            *v -= x;
        }
    }
}

/// Solve with the panel of a front: its own unknowns `y[..c]` are found, the later ones `y[c..]` updated.
#[multiversion(targets("x86_64+avx+avx2"))]
pub fn forward(panel: &[f64], c: usize, y: &mut [f64]) {
    let m = y.len();
    let mut k = 0;
    while k + 4 <= c {
        let l: [&[f64]; 4] = std::array::from_fn(|s| &panel[(k + s) * m..(k + s + 1) * m]);
        let mut v = [0.0; 4];
        for s in 0..4 {
            let known: f64 = (0..s).map(|q| l[q][k + s] * v[q]).sum();
            v[s] = (y[k + s] - known) / l[s][k + s];
            y[k + s] = v[s];
        }
        add_four(&mut y[k + 4..], l.map(|l| &l[k + 4..]), v.map(|v| -v));
        k += 4;
    }
    for k in k..c {
        let l = &panel[k * m..(k + 1) * m];
        let v = y[k] / l[k];
        y[k] = v;
        add_one(&mut y[k + 1..], &l[k + 1..], -v);
    }
}

/// Solve with the transposed panel of a front: `y[c..]` is known, `y[..c]` is found.
#[multiversion(targets("x86_64+avx+avx2"))]
pub fn backward(panel: &[f64], c: usize, y: &mut [f64]) {
    let m = y.len();
    let tail = c % 4;
    for k in (c - tail..c).rev() {
        let l = &panel[k * m..(k + 1) * m];
        y[k] = (y[k] - dots([&l[k + 1..]], &y[k + 1..])[0]) / l[k];
    }
    for k in (0..c - tail).step_by(4).rev() {
        let l: [&[f64]; 4] = std::array::from_fn(|s| &panel[(k + s) * m..(k + s + 1) * m]);
        let sums = dots(l.map(|l| &l[k + 4..]), &y[k + 4..]);
        for s in (0..4).rev() {
            let known: f64 = (s + 1..4).map(|q| l[s][k + q] * y[k + q]).sum();
            y[k + s] = (y[k + s] - sums[s] - known) / l[s][k + s];
        }
    }
}

/// Dot products of several vectors with one, each summed in four interleaved parts.
#[inline(always)]
pub fn dots<const N: usize>(a: [&[f64]; N], x: &[f64]) -> [f64; N] {
    let mut sum = [[0.0; 4]; N];
    let whole = x.len() / 4 * 4;
    for at in (0..whole).step_by(4) {
        let x = &x[at..at + 4];
        for (sum, a) in sum.iter_mut().zip(a) {
            let a = &a[at..at + 4];
            for l in 0..4 {
                sum[l] += a[l] * x[l];
            }
        }
    }
    std::array::from_fn(|n| {
        let tail: f64 = a[n][whole..].iter().zip(&x[whole..]).map(|(a, x)| a * x).sum();
        (sum[n][0] + sum[n][1]) + (sum[n][2] + sum[n][3]) + tail
    })
}

#[inline(always)]
fn add_one(y: &mut [f64], x: &[f64], factor: f64) {
    for (y, x) in y.iter_mut().zip(x) {
        *y += factor * x;
    }
}

/// One pass over y for four columns.
#[inline(always)]
fn add_four(y: &mut [f64], x: [&[f64]; 4], f: [f64; 4]) {
    let n = y.len();
    let [x0, x1, x2, x3] = x.map(|x| &x[..n]);
    for i in 0..n {
        y[i] += (f[0] * x0[i] + f[1] * x1[i]) + (f[2] * x2[i] + f[3] * x3[i]);
    }
}

/// Rows of a small weighted least-squares problem, collected and added to its normal equations four at a time.
pub struct RowBlock {
    stride: usize,
    rows: Vec<f64>,
    weight: [f64; 4],
    wanted: [f64; 4],
    count: usize,
    /// Normal matrix, row-major, right up to the end of the block of four columns that holds the diagonal.
    pub matrix: Vec<f64>,
    pub rhs: Vec<f64>,
}

impl Default for RowBlock {
    fn default() -> Self {
        Self::new()
    }
}

impl RowBlock {
    pub fn new() -> Self {
        let (rows, matrix, rhs) = (Vec::new(), Vec::new(), Vec::new());
        Self {
            stride: 0,
            rows,
            weight: [0.0; 4],
            wanted: [0.0; 4],
            count: 0,
            matrix,
            rhs,
        }
    }

    /// Start a problem with `size` unknowns.
    pub fn start(&mut self, size: usize) {
        self.stride = size.next_multiple_of(4);
        self.rows.clear();
        self.rows.resize(4 * self.stride, 0.0);
        self.matrix.clear();
        self.matrix.resize(self.stride * self.stride, 0.0);
        self.rhs.clear();
        self.rhs.resize(self.stride, 0.0);
        self.count = 0;
    }

    /// Distance of the matrix's rows.
    pub fn stride(&self) -> usize {
        self.stride
    }

    /// Room for the next row `row . unknowns = wanted`.
    #[inline]
    pub fn row(&mut self, wanted: f64, weight: f64) -> &mut [f64] {
        if self.count == 4 {
            self.flush();
        }
        let k = self.count;
        (self.weight[k], self.wanted[k]) = (weight, wanted);
        self.count += 1;
        &mut self.rows[k * self.stride..(k + 1) * self.stride]
    }

    /// Room for four rows at once, `stride` apart.
    #[inline]
    pub fn four_rows(&mut self, wanted: [f64; 4], weight: [f64; 4]) -> &mut [f64] {
        self.flush();
        (self.weight, self.wanted, self.count) = (weight, wanted, 4);
        &mut self.rows
    }

    /// Add what was collected.
    pub fn flush(&mut self) {
        if self.count == 0 {
            return;
        }
        self.weight[self.count..].fill(0.0);
        self.count = 0;
        add_rows(
            &self.rows,
            &self.weight,
            &self.wanted,
            &mut self.matrix,
            &mut self.rhs,
        );
    }
}

/// Add sum_k weight_k row_k row_k^T and sum_k weight_k wanted_k row_k for four rows.
#[multiversion(targets("x86_64+avx+avx2"))]
fn add_rows(rows: &[f64], weight: &[f64; 4], wanted: &[f64; 4], matrix: &mut [f64], rhs: &mut [f64]) {
    let n = rhs.len();
    let (r01, r23) = rows.split_at(2 * n);
    let ((r0, r1), (r2, r3)) = (r01.split_at(n), r23.split_at(n));
    for i in 0..n {
        let f = [
            weight[0] * r0[i],
            weight[1] * r1[i],
            weight[2] * r2[i],
            weight[3] * r3[i],
        ];
        let end = (i | 3) + 1;
        add_four(
            &mut matrix[i * n..i * n + end],
            [&r0[..end], &r1[..end], &r2[..end], &r3[..end]],
            f,
        );
        rhs[i] += (f[0] * wanted[0] + f[1] * wanted[1]) + (f[2] * wanted[2] + f[3] * wanted[3]);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn positive(m: usize) -> Vec<f64> {
        let noise = |i: usize, j: usize| ((i * 37 + j * 11) as f64).sin();
        let mut a = vec![0.0; m * m];
        for j in 0..m {
            for i in 0..m {
                a[j * m + i] = if i == j {
                    2.0 * m as f64
                } else {
                    noise(i.max(j), i.min(j))
                };
            }
        }
        a
    }

    #[test]
    fn blocked_elimination_is_that_of_the_textbook() {
        for (m, c) in [(1, 1), (5, 3), (40, 40), (77, 35), (130, 70)] {
            let mut a = positive(m);
            let mut b = a.clone();
            partial_cholesky(&mut a, m, c).unwrap();
            for k in 0..c {
                let root = b[k * m + k].sqrt();
                for i in k..m {
                    b[k * m + i] /= root;
                }
                for j in k + 1..m {
                    for i in j..m {
                        b[j * m + i] -= b[k * m + i] * b[k * m + j];
                    }
                }
            }
            for j in 0..m {
                for i in j..m {
                    let (x, y) = (a[j * m + i], b[j * m + i]);
                    assert!((x - y).abs() < 1e-13 * 2.0 * m as f64, "{m} {c} {i} {j}: {x} {y}");
                }
            }
        }
    }

    #[test]
    fn solves_undo_the_product() {
        for m in [1, 3, 4, 9, 30] {
            let a = positive(m);
            let x: Vec<f64> = (0..m).map(|i| (i as f64).cos()).collect();
            let mut y: Vec<f64> = (0..m)
                .map(|i| (0..m).map(|j| a[j * m + i] * x[j]).sum())
                .collect();
            let mut l = a.clone();
            partial_cholesky(&mut l, m, m).unwrap();
            forward(&l, m, &mut y);
            backward(&l, m, &mut y);
            assert!(x.iter().zip(&y).all(|(x, y)| (x - y).abs() < 1e-13));
        }
    }

    #[test]
    fn row_blocks_add_up_to_the_normal_equations() {
        let size = 7;
        let mut block = RowBlock::new();
        block.start(size);
        let entry = |k: usize, i: usize| ((3 * k + 5 * i) as f64).sin();
        for k in 0..6 {
            for (i, v) in block.row(k as f64, 0.5 + k as f64)[..size].iter_mut().enumerate() {
                *v = entry(k, i);
            }
        }
        block.flush();
        for i in 0..size {
            for j in 0..=i {
                let sum: f64 = (0..6).map(|k| (0.5 + k as f64) * entry(k, i) * entry(k, j)).sum();
                assert!((block.matrix[i * block.stride() + j] - sum).abs() < 1e-13);
            }
            let sum: f64 = (0..6).map(|k| (0.5 + k as f64) * entry(k, i) * k as f64).sum();
            assert!((block.rhs[i] - sum).abs() < 1e-13 * 10.0);
        }
    }
}
