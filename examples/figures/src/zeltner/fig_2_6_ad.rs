//! [Zeltner 2021, section 2.6]: the example of forward and reverse mode, `y = (x1 x2 x3, x1 x2 + x3)`.

use ad_core::{Chain, diff_fn, jvp, vjp};
use render::sampler::{Independent, Sampler};

use super::integration_1d::positions;
use examples::chart::LineChart;
use examples::figure::{Figure, Result};

diff_fn! {
    /// The example as a whole.
    pub fn example<R>([x1, x2, x3]: [R; 3]) -> [R; 2] {
        let v = x1 * x2;
        [v * x3, v + x3]
    }
}

diff_fn! {
    /// The first line of the example: the product that both outputs share.
    pub fn shared<R>([x1, x2, x3]: [R; 3]) -> [R; 3] {
        [x1 * x2, x3, R::zero()]
    }
}

diff_fn! {
    /// The second line of the example.
    pub fn outputs<R>([v, x3, _unused]: [R; 3]) -> [R; 3] {
        [v * x3, v + x3, R::zero()]
    }
}

/// A Jacobian, row by row: `dy1/dx1, dy1/dx2, dy1/dx3, dy2/dx1, ..`.
type Jacobian = [f64; 6];

/// A function that finds the Jacobian.
type Mode = fn([f64; 3]) -> Jacobian;

/// The Jacobian by forward mode: one pass per input gives one column.
fn forward(x: [f64; 3]) -> Jacobian {
    let column = |i: usize| {
        jvp(
            &example,
            x,
            std::array::from_fn(|k| f64::from(u8::from(k == i))),
        )
        .1
    };
    let columns = [column(0), column(1), column(2)];
    std::array::from_fn(|k| columns[k % 3][k / 3])
}

/// The Jacobian by reverse mode: one pass per output gives one row.
fn reverse(x: [f64; 3]) -> Jacobian {
    let rows = [
        vjp(&example, x, [1.0, 0.0]).1,
        vjp(&example, x, [0.0, 1.0]).1,
    ];
    std::array::from_fn(|k| rows[k / 3][k % 3])
}

/// As [`reverse`], through the two lines of the program one by one.
fn reverse_by_lines(x: [f64; 3]) -> Jacobian {
    let mut chain = Chain::<f64, 3, 3>::new();
    chain.start(x);
    chain.advance(&shared, []);
    chain.advance(&outputs, []);
    let row = |w| chain.pull_back(w, |_, []: [f64; 0]| ());
    let rows = [row([1.0, 0.0, 0.0]), row([0.0, 1.0, 0.0])];
    std::array::from_fn(|k| rows[k / 3][k % 3])
}

/// As printed in the thesis.
fn printed([x1, x2, x3]: [f64; 3]) -> Jacobian {
    [x2 * x3, x1 * x3, x1 * x2, x2, x1, 1.0]
}

/// `zeltner-2-6-ad`.
pub fn figure(fig: &mut Figure) -> Result {
    let modes: [(&str, Mode); 3] = [
        ("forward mode, one pass per input", forward),
        ("reverse mode, one pass per output", reverse),
        ("reverse mode, line by line", reverse_by_lines),
    ];
    let x = [2.0, 3.0, 5.0];
    let (n, seed) = (fig.pick(1000, 100_000), 1);
    fig.note("points", n);
    fig.note("seed", seed);
    for (name, mode) in modes {
        let found = mode(x);
        fig.check(
            format!("{name}: the printed Jacobian [[x2 x3, x1 x3, x1 x2], [x2, x1, 1]], exactly"),
            found == printed(x),
            format!("at x = {x:?}: {:?}, {:?}", &found[..3], &found[3..]),
        );
        let point = |i| {
            Independent::new(seed, 0, i)
                .next_3d::<f64>()
                .map(|u| 4.0 * u - 2.0)
        };
        let different = (0..n)
            .filter(|&i| mode(point(i)) != printed(point(i)))
            .count();
        fig.check(
            format!("{name}: exactly equal, bit for bit, at random points of [-2, 2]^3"),
            different == 0,
            format!("{different} of {n} points differ"),
        );
    }
    let header = [
        "x1", "dy1_dx1", "dy1_dx2", "dy1_dx3", "dy2_dx1", "dy2_dx2", "dy2_dx3",
    ];
    let along = |x1| [x1, 0.7, -1.3];
    let rows = |mode: Mode| -> Vec<[f64; 7]> {
        positions([-2.0, 2.0], 20)
            .map(|x1| {
                let j = mode(along(x1));
                std::array::from_fn(|k| if k == 0 { x1 } else { j[k - 1] })
            })
            .collect()
    };
    let (by_forward, by_reverse) = (rows(forward), rows(reverse));
    let mut chart = LineChart::new(
        "y = (x1 x2 x3, x1 x2 + x3) at x2 = 0.7, x3 = -1.3: lines forward, points reverse",
        "x1",
        "derivative",
    )
    .x_range(-2.1, 3.2);
    let names = [
        "dy1/dx1", "dy1/dx2", "dy1/dx3", "dy2/dx1", "dy2/dx2", "dy2/dx3",
    ];
    for (k, name) in names.into_iter().enumerate() {
        chart = chart.line(name, by_forward.iter().map(|r| (r[0], r[k + 1])));
    }
    // The colours come in a cycle of seven.
    chart = chart.line("", []);
    for k in 0..6 {
        chart = chart.points("", by_reverse.iter().map(|r| (r[0], r[k + 1])));
    }
    fig.csv("forward", &header, by_forward);
    fig.csv("reverse", &header, by_reverse);
    fig.chart("jacobian", &chart);
    Ok(())
}
