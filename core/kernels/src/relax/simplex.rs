//! Shares of classes: numbers >= 0 that add up to 1.

/// Pixels that are worked on side by side.
const LANES: usize = 16;

/// The nearest shares to every column of `rows` (classes, cols).
#[inline(always)]
pub fn project(rows: &mut [f32], classes: usize) {
    let n = rows.len() / classes;
    let mut first = 0;
    while first < n {
        let count = LANES.min(n - first);
        let mut level = [f32::NEG_INFINITY; LANES];
        // Newton's method on sum max(y - level, 0) = 1, from below: each step but the last drops a class for good.
        for _ in 0..classes {
            let (mut sum, mut number) = ([-1.0_f32; LANES], [0.0_f32; LANES]);
            for class in 0..classes {
                let row = &rows[class * n + first..][..count];
                for j in 0..count {
                    let above = row[j] > level[j];
                    sum[j] += if above { row[j] } else { 0.0 };
                    number[j] += if above { 1.0 } else { 0.0 };
                }
            }
            for j in 0..count {
                level[j] = sum[j] / number[j];
            }
        }
        for class in 0..classes {
            let row = &mut rows[class * n + first..][..count];
            for j in 0..count {
                row[j] = (row[j] - level[j]).max(0.0);
            }
        }
        first += count;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Sorted from above, the shares stay positive down to where the level passes (Held, Wolfe and Crowder 1974).
    fn slow(values: &[f32]) -> Vec<f32> {
        let mut sorted = values.to_vec();
        sorted.sort_by(|a, b| b.total_cmp(a));
        let (mut sum, mut level) = (-1.0, 0.0);
        for (k, &v) in sorted.iter().enumerate() {
            sum += v;
            if v > sum / (k + 1) as f32 {
                level = sum / (k + 1) as f32;
            }
        }
        values.iter().map(|v| (v - level).max(0.0)).collect()
    }

    #[test]
    fn projects_as_the_sorted_search_does() {
        for classes in 2..7 {
            let n = 37;
            let mut rows: Vec<f32> = (0..n * classes)
                .map(|k| ((k * k) as f32 * 0.618_034).sin() * 2.0)
                .collect();
            let before = rows.clone();
            project(&mut rows, classes);
            for j in 0..n {
                let of = |rows: &[f32]| (0..classes).map(|c| rows[c * n + j]).collect::<Vec<_>>();
                let (found, wanted) = (of(&rows), slow(&of(&before)));
                assert!((found.iter().sum::<f32>() - 1.0).abs() < 1e-5);
                for (a, b) in found.iter().zip(&wanted) {
                    assert!((a - b).abs() < 1e-5, "{found:?} {wanted:?}");
                }
            }
        }
    }
}
