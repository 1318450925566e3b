use examples::figure::Result;
use examples::scene_builder::{SceneBuilder, View};
use render::instances::{Direction, Estimator, render_f64};
use render::params::Theta;
use render::{Job, Scene};
fn scene(profile: &[[f64; 2]], lamp: bool) -> Result<Scene> {
    let mut b = SceneBuilder::default();
    let rook = b.matt("rook", [0.75; 3])?;
    b.turned("rook", profile, [0.0; 3], &rook)?;
    if lamp {
        let black = b.matt("black", [0.0; 3])?;
        let sides = [[1.6, 0.0, 0.0], [0.0, 0.0, 1.6]];
        let light = b.quad("light", [[-3.4, 4.0, -0.1], sides[0], sides[1]], &black)?;
        b.lamp("light", light, [14.0; 3])?;
    } else {
        b.ambient([1.0; 3])?;
    }
    let view = View { eye: [-0.25, 2.4, 5.5], target: [0.0, 0.7, 0.0], fov: 20.0, size: [24, 24] };
    let mut s = b.finish(&view, 2)?;
    s.make_movable(&["rook.translation"])?;
    Ok(s)
}
fn main() -> Result {
    let full = examples::figures::common_scenes::ROOK;
    let solid = [[0.0, 0.0], [0.28, 0.0], [0.28, 1.16], [0.0, 1.16]];
    let hollow = [[0.0, 0.0], [0.28, 0.0], [0.28, 1.16], [0.18, 1.16], [0.18, 1.04], [0.0, 1.04]];
    let tower = [[0.0, 0.92], [0.28, 0.92], [0.28, 1.16], [0.0, 1.16]];
    for lamp in [false, true] { for (name, p) in [("full", &full[..]), ("solid", &solid), ("hollow", &hollow), ("tower", &tower)] {
        let mut s = scene(p, lamp)?;
        let spp = 256;
        let params = s.params();
        let info = params.find("rook.translation")?;
        let at = info.offset;
        let along = Direction::Dense(params.handle(info), vec![-1.0, 0.0, 0.0]);
        let job = Job::new(&s, &s.settings, 7, 0..spp, &());
        let seen = Estimator::Edges.forward_f32(&job, params.values(), &[along.clone()])?;
        let inner = Estimator::Interior.forward_f32(&job, params.values(), &[along])?;
        let start = params.values().to_vec();
        let mut d = vec![0.0; 24 * 24];
        for sign in [1.0f32, -1.0] {
            let mut v = start.clone(); v[at] -= sign / 128.0; s.set_params(&v)?;
            let wide: Vec<f64> = v.iter().map(|&v| v.into()).collect();
            let job = Job::new(&s, &s.settings, 9, 0..8 * spp, &());
            let r = render_f64(&job, &Theta::constant(&wide), Estimator::Mis);
            for (d, x) in d.iter_mut().zip(r.sums[0].iter().step_by(3)) { *d += f64::from(sign) * x * 64.0 / (8 * spp) as f64; }
        }
        println!("{name} lamp {lamp}: rows, left half and right half: edges (interior alone), differences");
        for y in 0..24 {
            let sum = |f: &dyn Fn(usize) -> f64, side: usize| (12 * side..12 * side + 12).map(|x| f(24 * y + x)).sum::<f64>();
            let e = |i: usize| seen.sums[1][3 * i] / spp as f64; let n = |i: usize| inner.sums[1][3 * i] / spp as f64; let f = |i: usize| d[i];
            if sum(&f, 0).abs() + sum(&e, 0).abs() > 1e-6 { println!("{y:2}  {:8.3} ({:7.3}) {:8.3}    {:8.3} ({:7.3}) {:8.3}", sum(&e, 0), sum(&n, 0), sum(&f, 0), sum(&e, 1), sum(&n, 1), sum(&f, 1)); }
        }
    } }
    Ok(())
}
