use ad_core::Dual;
use render::bsdf::Diffuse;
use render::camera::{Camera, FovAxis};
use render::emitter::Area;
use render::estimator::DetachedMis;
use render::integrator::{gradient, render as rr};
use render::math::Transform;
use render::params::Theta;
use render::sampler::Independent;
use render::scene::Builder;
use render::shape::{Patch, Rectangle};
use render::{Film, Settings};
fn main() {
    let mut b = Builder::new();
    let mut mat = |b: &mut Builder, n: &str, c: [f64; 3]| {
        let reflectance = b.rgb(&format!("{n}.reflectance.value"), c, (0.0, 1.0)).unwrap();
        b.add_material(Diffuse { reflectance })
    };
    let white = mat(&mut b, "white", [0.7; 3]);
    let red = mat(&mut b, "red", [0.63, 0.065, 0.05]);
    let green = mat(&mut b, "green", [0.14, 0.45, 0.091]);
    let black = mat(&mut b, "black", [0.0; 3]);
    let t = |ops: &[Transform]| Transform::sequence(ops.iter().cloned());
    let tr = |x, y, z| Transform::translate([x, y, z]);
    let rx = |a| Transform::rotate([1., 0., 0.], a).unwrap();
    let ry = |a| Transform::rotate([0., 1., 0.], a).unwrap();
    let sc = |x, y, z| Transform::scale([x, y, z]);
    let rect = |w: &Transform| Rectangle(Patch::new(w.point([-1., -1., 0.]), w.vector([2., 0., 0.]), w.vector([0., 2., 0.]), false).unwrap());
    b.add_shape("floor", rect(&t(&[rx(-90.), tr(0., -1., 0.)])), white);
    b.add_shape("ceiling", rect(&t(&[rx(90.), tr(0., 1., 0.)])), white);
    b.add_shape("back", rect(&tr(0., 0., -1.)), white);
    b.add_shape("left", rect(&t(&[ry(90.), tr(-1., 0., 0.)])), red);
    b.add_shape("right", rect(&t(&[ry(-90.), tr(1., 0., 0.)])), green);
    for w in [t(&[sc(0.3, 0.3, 0.3), ry(-17.), tr(0.335, -0.7, 0.38)]), t(&[sc(0.3, 0.6, 0.3), ry(18.25), tr(-0.335, -0.4, -0.28)])] {
        for f in [t(&[tr(0., 0., 1.)]), t(&[tr(0., 0., 1.), ry(90.)]), t(&[tr(0., 0., 1.), ry(180.)]), t(&[tr(0., 0., 1.), ry(270.)]), t(&[tr(0., 0., 1.), rx(90.)]), t(&[tr(0., 0., 1.), rx(-90.)])] {
            b.add_shape("box", rect(&f.then(&w)), white);
        }
    }
    let l = b.add_shape("light", rect(&t(&[sc(0.25, 0.25, 1.), rx(90.), tr(0., 0.99, 0.)])), black);
    let radiance = b.rgb("light.emitter.radiance.value", [18., 14., 9.], (0., 1e9)).unwrap();
    b.add_emitter(Area { radiance, exponent: 0.0, shape: l }, Some(l));
    let cam = Camera::new(Transform::look_at([0., 0., 3.9], [0.; 3], [0., 1., 0.]).unwrap(), 39.3077, FovAxis::X, [256, 256]).unwrap();
    let scene = b.build(cam, Film::new(256, 256), Settings::default()).unwrap();
    let theta = Theta::constant(scene.params().values());
    let active = gradient::Active::new(&scene, &["white.reflectance.value", "red.reflectance.value", "green.reflectance.value"]).unwrap();
    let adj = vec![1.0 / (256. * 256. * 3.); 256 * 256 * 3];
    let pool = rayon::ThreadPoolBuilder::new().num_threads(2).build().unwrap();
    pool.install(|| {
        for i in 0..3 {
            let t = cpu();
            let r = rr::render::<f32, DetachedMis, Independent>(&scene, &theta, &scene.settings, i, 0..64, &());
            let tp = (cpu() - t);
            if std::env::args().nth(1).is_some() { println!("{tp:.3}"); continue; }
            let t = cpu();
            let g = gradient::backward::<f32, Independent>(&scene, &theta, &active, &adj, &scene.settings, i, 0..64, &()).unwrap();
            let tg = (cpu() - t);
            println!("{tp:.3} {tg:.3} ratio {:.3} {:?} {:?}", tg / tp, r.mean(0), g.values);
        }
        if std::env::args().nth(1).is_some() { return; }
        let t = cpu();
        let tangents: Vec<_> = scene.params().infos().iter().map(|i| if i.name.starts_with("red") { render::params::Tangent::Uniform(Dual::<f32, 1>::var(0.0, 0)) } else { render::params::Tangent::None }).collect();
        let th = Theta::with_tangents(scene.params().values(), &tangents);
        let r = rr::render::<Dual<f32, 1>, DetachedMis, Independent>(&scene, &th, &scene.settings, 0, 0..64, &());
        println!("fwd {:.3} {:?}", (cpu() - t), r.mean(1));
    });
}
fn cpu() -> f64 {
    let s = std::fs::read_to_string("/proc/self/stat").unwrap();
    let f: Vec<&str> = s.rsplit(')').next().unwrap().split_whitespace().collect();
    (f[11].parse::<f64>().unwrap() + f[12].parse::<f64>().unwrap()) / 100.0
}
