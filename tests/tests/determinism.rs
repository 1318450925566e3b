//! Results are a function of the seed alone: bit-identical for any number of threads.

use tests::{cases, image, mean_adjoint, on_any_threads, reverse, scene, smooth_params, values};

#[test]
fn images_and_gradients_do_not_depend_on_threads() {
    for (k, case) in cases::all().into_iter().enumerate() {
        // Several tiles, the last ones incomplete.
        let body = case.body.replace("value=\"8\"", "value=\"40\"");
        let mut s = scene(&body);
        assert_eq!(s.film.crop_size, [40, 40], "{}", case.name);
        if k % 2 == 1 {
            // As many samples of each pixel, or not.
            let weights: Vec<f32> = (0..40 * 40).map(|i| (i % 7) as f32).collect();
            s.set_pixel_weights(&weights).expect("weights");
        }
        let v = values::<f32>(&s);
        let params = smooth_params(&s);
        let adjoint = mean_adjoint(&s);
        println!("{}", case.name);
        let (sums, _) = on_any_threads(|| {
            let i = image::<f32>(&s, &v, &s.settings, 5, 4);
            let g = reverse::<f32>(&s, &params, &adjoint, &s.settings, 6, 4);
            (i.sums, g)
        });
        assert!(sums[0].iter().any(|&x| x > 0.0));
    }
}

#[test]
fn another_seed_is_another_image() {
    let s = scene(&cases::all()[0].body);
    let v = values::<f32>(&s);
    let run = |seed| image::<f32>(&s, &v, &s.settings, seed, 4).sums;
    assert!(run(1) != run(2));
    assert!(run(1) == run(1));
}
