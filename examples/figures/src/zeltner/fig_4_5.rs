//! An adjoint image sent backward through a scene [Zeltner 2021, figure 4.5].

use super::propagation::{CHANGE, SEED, board, grey, list};
use examples::chart::Panel;
use examples::figure::{Figure, Result};

/// `zeltner-4-5`.
///
/// # Errors
/// None that the built-in scene can cause.
pub fn figure(fig: &mut Figure) -> Result {
    let board = board(fig)?;
    board.identities(fig)?;
    let gradient = board.gradient(SEED)?;
    let signs = gradient.iter().zip(CHANGE).all(|(g, d)| g * d < 0.0);
    fig.check(
        "the adjoint pass says which way to change the bishop: towards the target in every channel",
        signs,
        format!(
            "gradient {}, change that would fit {CHANGE:?}",
            list(&gradient)
        ),
    );
    let width = board.image.width;
    let enlarge = fig.pick(4, 2);
    let adjoint = |c: usize| -> Vec<f64> {
        let channel = board.adjoint.iter().skip(c).step_by(3);
        channel
            .map(|&a| f64::from(a) * board.adjoint.len() as f64)
            .collect()
    };
    // The summands of the gradient, per pixel.
    let derivative = board.derivative(SEED)?;
    let products = derivative.sums[1].iter().zip(&board.adjoint);
    let n = board.spp as f64;
    let products = products.map(|(s, &a)| s / n * f64::from(a) * board.adjoint.len() as f64);
    let products = grey(products);
    let panels = [
        Panel::tonemapped("image", &board.image, 1.0).enlarged(enlarge),
        Panel::tonemapped("target", &board.target, 1.0).enlarged(enlarge),
        Panel::signed("adjoint image sent in, red", width, &adjoint(0), None).enlarged(enlarge),
        Panel::signed("adjoint times derivative", width, &products, None).enlarged(enlarge),
    ];
    fig.images("reverse", 2, &panels);
    Ok(())
}
