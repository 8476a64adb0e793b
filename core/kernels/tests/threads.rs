//! The same bits on any number of threads.

use tspline_kernels::{bulk, contour, project, refine, surface, Equations, System, TMesh};

fn on<T: Send>(threads: usize, work: impl FnOnce() -> T + Send) -> T {
    rayon::ThreadPoolBuilder::new()
        .num_threads(threads)
        .build()
        .unwrap()
        .install(work)
}

/// Coefficients at the Greville abscissae: a field near the distance from a circle or sphere.
fn ball<const D: usize>(mesh: &TMesh<D>) -> Vec<f64> {
    let side = f64::from(1_u32 << 20);
    let square = |k: &[u32; 5]| (f64::from(k[1] + k[2] + k[3]) / 3.0 / side - 0.5).powi(2);
    mesh.knots()
        .iter()
        .map(|k| k.iter().map(square).sum::<f64>().sqrt() - 0.3)
        .collect()
}

fn scattered<const D: usize>(count: u32) -> Vec<[f64; D]> {
    let step = [0.618_034, 0.754_878, 0.569_840];
    (0..count)
        .map(|k| std::array::from_fn(|a| (f64::from(k) * step[a]).fract()))
        .collect()
}

/// Points on a circle, in 3D with a wave in the third coordinate, with levels that make a graded mesh.
fn graded<const D: usize>(level: u8) -> TMesh<D> {
    let points: Vec<[f64; D]> = (0..500)
        .map(|k| {
            let t = f64::from(k) / 500.0 * std::f64::consts::TAU;
            std::array::from_fn(|a| 0.5 + 0.3 * [t.cos(), t.sin(), (3.0 * t).sin() * 0.5][a])
        })
        .collect();
    refine::from_points(&points, &vec![level; points.len()], 1, 2, 1_000_000).unwrap()
}

fn bits(values: &[f64]) -> Vec<u64> {
    values.iter().map(|v| v.to_bits()).collect()
}

fn evaluate_and_solve<const D: usize>(level: u8, threads: usize) -> Vec<Vec<u64>> {
    on(threads, || {
        let mesh = graded::<D>(level);
        let c = ball(&mesh);
        let field = bulk::evaluate(&mesh, &c, &scattered(200_000), 1).unwrap();
        let samples = scattered::<D>(3000);
        let (feet, _) = project::project(&mesh, &c, &samples[..500], &samples[..500], 0.1).unwrap();
        let weights = vec![1.0 / 3000.0; 3000];
        let speed: Vec<f64> = samples.iter().map(|x| (9.0 * x[0]).sin()).collect();
        let smoothing = vec![0.01; 3000];
        let equations = Equations {
            coefficients: &c,
            points: &samples,
            weights: &weights,
            speed: &speed,
            plain: false,
            smoothing: Some(&smoothing),
            time_step: 0.1,
            constraint_weight: 0.01,
            relaxation: 1.0,
            constraint_band: 1.0,
            far_weight: 0.5,
            fairness: 1e-6,
            damping: 1e-7,
            tolerance: 1e-10,
            diagonal: 0,
        };
        let mut system = System::new(&mesh).unwrap();
        let first = system.solve(&mesh, &equations, None).unwrap();
        let heavier = Equations {
            constraint_weight: 0.013,
            ..equations
        };
        let second = system.solve(&mesh, &heavier, Some(&first.rates)).unwrap();
        let loose = Equations {
            tolerance: 1e-3,
            diagonal: 300,
            ..heavier
        };
        let third = system.solve(&mesh, &loose, Some(&first.rates)).unwrap();
        vec![
            bits(&field.values),
            bits(field.gradients.as_flattened()),
            bits(feet.as_flattened()),
            bits(&first.rates),
            bits(&first.realised),
            bits(&second.rates),
            bits(&third.rates),
            bits(system.matrix().2),
            bits(&[first.gradient_deviation, second.gradient_deviation]),
        ]
    })
}

#[test]
fn evaluation_and_solution_in_the_plane() {
    let one = evaluate_and_solve::<2>(7, 1);
    for threads in [2, 5] {
        assert!(evaluate_and_solve::<2>(7, threads) == one, "{threads} threads");
    }
}

#[test]
fn evaluation_and_solution_in_space() {
    let one = evaluate_and_solve::<3>(4, 1);
    assert!(evaluate_and_solve::<3>(4, 2) == one);
}

#[test]
fn loops() {
    let lines = |threads| {
        on(threads, || {
            let mesh = graded::<2>(7);
            let loops = contour::loops(&mesh, &ball(&mesh), 2).unwrap();
            assert_eq!(loops.start.len(), 2);
            (loops.start, bits(loops.vertices.as_flattened()))
        })
    };
    let one = lines(1);
    assert!(lines(2) == one && lines(5) == one);
}

#[test]
fn surfaces() {
    let triangles = |threads| {
        on(threads, || {
            let mesh = graded::<3>(5);
            let s = surface::surface(&mesh, &ball(&mesh), 1).unwrap();
            assert!(s.triangles.len() > 10_000);
            (
                s.triangles,
                bits(s.vertices.as_flattened()),
                bits(s.normals.as_flattened()),
            )
        })
    };
    let one = triangles(1);
    assert!(triangles(2) == one && triangles(5) == one);
}
