//! Charts and labelled pictures.

use std::error::Error;
use std::io::Cursor;
use std::ops::Range;
use std::sync::Once;

use plotters::coord::Shift;
use plotters::coord::combinators::WithKeyPoints;
use plotters::coord::ranged1d::{AsRangedCoord, Ranged, ValueFormatter};
use plotters::prelude::*;
use render::Image;

use crate::ranks::percentile;

type Result<T> = std::result::Result<T, Box<dyn Error>>;

/// The font that is compiled in.
pub(crate) const FONT: &str = "chart";
/// Size of a chart, pixels.
const SIZE: (u32, u32) = (960, 640);
/// Colours that stay apart for colour-blind readers [Okabe and Ito 2008].
const COLOURS: [RGBColor; 7] = [
    RGBColor(0, 114, 178),
    RGBColor(213, 94, 0),
    RGBColor(0, 158, 115),
    RGBColor(204, 121, 167),
    RGBColor(230, 159, 0),
    RGBColor(86, 180, 233),
    RGBColor(0, 0, 0),
];

pub(crate) fn register_font() {
    static ONCE: Once = Once::new();
    ONCE.call_once(|| {
        let font = include_bytes!("../assets/roboto-latin-greek.ttf");
        // Without it, drawing text reports the missing font.
        let _ = plotters::style::register_font(FONT, FontStyle::Normal, font);
    });
}

/// An SVG file that names a font that viewers have, not the compiled-in one.
pub(crate) fn readable_font(svg: &str) -> String {
    let ours = format!("font-family=\"{FONT}\"");
    svg.replace(&ours, "font-family=\"Roboto, sans-serif\"")
}

/// Whether the points of a series are joined, and how.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Style {
    Line,
    Dashed,
    Points,
    LineAndPoints,
}

#[derive(Clone, Debug)]
struct Series {
    label: String,
    style: Style,
    points: Vec<(f64, f64)>,
}

/// Curves over two axes, each linear or logarithmic. Points that are not finite (or beyond 1e100), or
/// not positive on a logarithmic axis, are left out.
#[derive(Clone, Debug)]
pub struct LineChart {
    title: String,
    x: String,
    y: String,
    log: (bool, bool),
    x_range: Option<(f64, f64)>,
    y_range: Option<(f64, f64)>,
    series: Vec<Series>,
}

impl LineChart {
    /// An empty chart with a title and labels of the axes.
    pub fn new(title: &str, x: &str, y: &str) -> Self {
        Self {
            title: title.into(),
            x: x.into(),
            y: y.into(),
            log: (false, false),
            x_range: None,
            y_range: None,
            series: Vec::new(),
        }
    }

    /// With a logarithmic horizontal axis.
    pub fn log_x(mut self) -> Self {
        self.log.0 = true;
        self
    }

    /// With a logarithmic vertical axis.
    pub fn log_y(mut self) -> Self {
        self.log.1 = true;
        self
    }

    /// With a fixed horizontal range instead of that of the points, unless the axis has no place for it.
    pub fn x_range(mut self, low: f64, high: f64) -> Self {
        self.x_range = Some((low, high));
        self
    }

    /// With a fixed vertical range instead of that of the points, unless the axis has no place for it.
    pub fn y_range(mut self, low: f64, high: f64) -> Self {
        self.y_range = Some((low, high));
        self
    }

    fn with(
        mut self,
        style: Style,
        label: &str,
        points: impl IntoIterator<Item = (f64, f64)>,
    ) -> Self {
        self.series.push(Series {
            label: label.into(),
            style,
            points: points.into_iter().collect(),
        });
        self
    }

    /// With a curve.
    pub fn line(self, label: &str, points: impl IntoIterator<Item = (f64, f64)>) -> Self {
        self.with(Style::Line, label, points)
    }

    /// With a dashed curve: references, models.
    pub fn dashed(self, label: &str, points: impl IntoIterator<Item = (f64, f64)>) -> Self {
        self.with(Style::Dashed, label, points)
    }

    /// With points that are not joined.
    pub fn points(self, label: &str, points: impl IntoIterator<Item = (f64, f64)>) -> Self {
        self.with(Style::Points, label, points)
    }

    /// With points that are joined: measurements over a parameter.
    pub fn measured(self, label: &str, points: impl IntoIterator<Item = (f64, f64)>) -> Self {
        self.with(Style::LineAndPoints, label, points)
    }

    /// As a PNG file.
    ///
    /// # Errors
    /// Those of the drawing library.
    pub fn png(&self) -> Result<Vec<u8>> {
        let mut pixels = vec![255u8; (SIZE.0 * SIZE.1 * 3) as usize];
        self.draw(BitMapBackend::with_buffer(&mut pixels, SIZE).into_drawing_area())?;
        encode_png(&pixels, SIZE)
    }

    /// As an SVG file.
    ///
    /// # Errors
    /// Those of the drawing library.
    pub fn svg(&self) -> Result<String> {
        let mut text = String::new();
        self.draw(SVGBackend::with_string(&mut text, SIZE).into_drawing_area())?;
        Ok(readable_font(&text))
    }

    fn visible(&self, p: &(f64, f64)) -> bool {
        fits(p.0, self.log.0) && fits(p.1, self.log.1)
    }

    fn range(
        &self,
        fixed: Option<(f64, f64)>,
        log: bool,
        pick: impl Fn(&(f64, f64)) -> f64,
    ) -> Range<f64> {
        if let Some((low, high)) = fixed.filter(|r| fits(r.0, log) && fits(r.1, log) && r.0 < r.1) {
            return if log {
                with_power_of_ten(low..high)
            } else {
                low..high
            };
        }
        let all = self.series.iter().flat_map(|s| &s.points);
        let (low, high) = all
            .filter(|p| self.visible(p))
            .map(pick)
            .fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), v| {
                (l.min(v), h.max(v))
            });
        if low > high {
            return if log { 0.1..1.0 } else { 0.0..1.0 };
        }
        if log {
            let margin = (high / low).powf(0.05).max(1.2);
            with_power_of_ten(low / margin..high * margin)
        } else {
            let margin = (0.05 * (high - low)).max(1e-6 * high.abs()).max(1e-12);
            low - margin..high + margin
        }
    }

    /// What is drawn, horizontally and vertically.
    fn ranges(&self) -> [Range<f64>; 2] {
        [
            self.range(self.x_range, self.log.0, |p| p.0),
            self.range(self.y_range, self.log.1, |p| p.1),
        ]
    }

    fn draw<DB: DrawingBackend>(&self, area: DrawingArea<DB, Shift>) -> Result<()>
    where
        DB::ErrorType: 'static,
    {
        register_font();
        area.fill(&WHITE)?;
        let [x, y] = self.ranges();
        match self.log {
            (false, false) => self.draw_on(&area, x, y)?,
            (true, false) => self.draw_on(&area, logarithmic(x), y)?,
            (false, true) => self.draw_on(&area, x, logarithmic(y))?,
            (true, true) => self.draw_on(&area, logarithmic(x), logarithmic(y))?,
        }
        area.present()?;
        Ok(())
    }

    fn draw_on<DB, X, Y>(&self, area: &DrawingArea<DB, Shift>, x: X, y: Y) -> Result<()>
    where
        DB: DrawingBackend,
        DB::ErrorType: 'static,
        X: AsRangedCoord<Value = f64>,
        Y: AsRangedCoord<Value = f64>,
        X::CoordDescType: Ranged<ValueType = f64> + ValueFormatter<f64>,
        Y::CoordDescType: Ranged<ValueType = f64> + ValueFormatter<f64>,
    {
        let mut chart = ChartBuilder::on(area)
            .caption(&self.title, (FONT, 24))
            .margin(16)
            .x_label_area_size(52)
            .y_label_area_size(84)
            .build_cartesian_2d(x, y)?;
        chart
            .configure_mesh()
            .x_desc(&self.x)
            .y_desc(&self.y)
            .axis_desc_style((FONT, 18))
            .label_style((FONT, 15))
            .light_line_style(RGBColor(238, 238, 238))
            .x_label_formatter(&|v| number(*v))
            .y_label_formatter(&|v| number(*v))
            .draw()?;
        let [across, up] = self.ranges();
        for (i, s) in self.series.iter().enumerate() {
            let colour = COLOURS[i % COLOURS.len()];
            let points = || s.points.iter().copied().filter(|p| self.visible(p));
            let mut handle = None;
            match s.style {
                Style::Line | Style::LineAndPoints => {
                    let line = LineSeries::new(points(), colour.stroke_width(2));
                    handle = Some(chart.draw_series(line)?);
                }
                Style::Dashed => {
                    let line = DashedLineSeries::new(points(), 8, 6, colour.stroke_width(2));
                    handle = Some(chart.draw_series(line)?);
                }
                Style::Points => {}
            }
            let dotted = matches!(s.style, Style::Points | Style::LineAndPoints);
            // Colours repeat after a while; rings tell their second users from the first.
            let dot = if i < COLOURS.len() {
                colour.filled()
            } else {
                colour.stroke_width(2)
            };
            if dotted {
                // The drawing library moves what is outside to the edge.
                let inside = |p: &(f64, f64)| {
                    let within = |v: f64, r: &Range<f64>| v >= r.start && v <= r.end;
                    within(p.0, &across) && within(p.1, &up)
                };
                let dots = points().filter(inside).map(|p| Circle::new(p, 4, dot));
                handle = Some(chart.draw_series(dots)?);
            }
            if let (Some(handle), false) = (handle, s.label.is_empty()) {
                let handle = handle.label(&s.label);
                if dotted {
                    handle.legend(move |(x, y)| Circle::new((x + 9, y), 4, dot))
                } else {
                    handle.legend(move |(x, y)| {
                        Rectangle::new([(x, y - 2), (x + 18, y + 2)], colour.filled())
                    })
                };
            }
        }
        if self.series.iter().any(|s| !s.label.is_empty()) {
            chart
                .configure_series_labels()
                .position(SeriesLabelPosition::UpperRight)
                .background_style(WHITE.mix(0.85))
                .border_style(RGBColor(160, 160, 160))
                .label_font((FONT, 16))
                .draw()?;
        }
        Ok(())
    }
}

/// Whether a number has a place on an axis. Those of the drawing library do not end for numbers beyond these.
fn fits(v: f64, log: bool) -> bool {
    v.abs() < 1e100 && if log { v > 1e-100 } else { true }
}

/// The range, widened to the nearest power of ten if it holds none, so that it has a number.
fn with_power_of_ten(range: Range<f64>) -> Range<f64> {
    let (low, high) = (range.start.log10(), range.end.log10());
    if low.ceil() <= high {
        range
    } else if low - low.floor() < high.ceil() - high {
        10f64.powf(low.floor())..range.end
    } else {
        range.start..10f64.powf(high.ceil())
    }
}

/// A logarithmic axis, with numbers at [`ticks`].
fn logarithmic(range: Range<f64>) -> WithKeyPoints<LogCoord<f64>> {
    let ticks = ticks(&range);
    range.log_scale().with_key_points(ticks)
}

/// Numbers on a logarithmic axis: at 1, 2 and 5 of each decade, or at as many powers of ten as do not overlap. The drawing
/// library itself knows none below the first power of ten.
fn ticks(range: &Range<f64>) -> Vec<f64> {
    const MOST: usize = 12;
    let decades = range.start.log10().floor() as i32..=range.end.log10().ceil() as i32;
    let of = |leading: &[f64], every: usize| -> Vec<f64> {
        let decades = decades.clone().filter(|d| d.rem_euclid(every as i32) == 0);
        let all = decades.flat_map(|d| leading.iter().map(move |l| l * 10f64.powi(d)));
        all.filter(|v| range.contains(v) || *v == range.end)
            .collect()
    };
    let mut found = of(&[1.0, 2.0, 5.0], 1);
    for every in 1.. {
        if found.len() <= MOST {
            break;
        }
        found = of(&[1.0], every);
    }
    found
}

/// A short decimal: `0.25`, `1e-6`.
pub(crate) fn number(v: f64) -> String {
    let a = v.abs();
    if a == 0.0 {
        "0".into()
    } else if (1e-3..1e5).contains(&a) {
        let text = format!("{v:.4}");
        text.trim_end_matches('0').trim_end_matches('.').into()
    } else if a < 1e-14 {
        "0".into()
    } else {
        let text = format!("{v:.2e}");
        text.replace(".00e", "e").replace("0e", "e")
    }
}

/// A labelled 8-bit picture.
#[derive(Clone, Debug)]
pub struct Panel {
    /// Shown above it.
    pub label: String,
    width: usize,
    height: usize,
    rgb: Vec<u8>,
}

impl Panel {
    /// A linear image times `exposure`, in sRGB.
    pub fn tonemapped(label: &str, image: &Image, exposure: f64) -> Self {
        let encode = |&v: &f32| srgb(f64::from(v) * exposure);
        Self {
            label: label.into(),
            width: image.width,
            height: image.height,
            rgb: image.data.iter().map(encode).collect(),
        }
    }

    /// Signed numbers `[height][width]`: white at zero, blue below, red above, full colour at `+-scale`.
    /// Without `scale`, the 99th percentile of the magnitude. The label tells the scale.
    pub fn signed(label: &str, width: usize, values: &[f64], scale: Option<f64>) -> Self {
        let scale = scale.unwrap_or_else(|| percentile(values, 0.99));
        let rgb = values.iter().flat_map(|&v| {
            let t = if scale > 0.0 {
                (v / scale).clamp(-1.0, 1.0)
            } else {
                0.0
            };
            // Ends: (178, 24, 43) and (33, 102, 172), through white.
            let end = if t < 0.0 {
                [33.0, 102.0, 172.0]
            } else {
                [178.0, 24.0, 43.0]
            };
            let t = t.abs();
            end.map(|e: f64| (255.0 + t * (e - 255.0)).round() as u8)
        });
        Self {
            label: format!("{label}  [±{}]", number(scale)),
            width,
            height: values.len() / width.max(1),
            rgb: rgb.collect(),
        }
    }

    /// Numbers `[height][width]` in false colour from `low` (dark blue) to `high` (yellow). The label
    /// tells the range.
    pub fn false_colour(label: &str, width: usize, values: &[f64], low: f64, high: f64) -> Self {
        let rgb = values
            .iter()
            .flat_map(|&v| viridis((v - low) / (high - low)));
        Self {
            label: format!("{label}  [{}, {}]", number(low), number(high)),
            width,
            height: values.len() / width.max(1),
            rgb: rgb.collect(),
        }
    }

    /// Columns and rows, pixels.
    pub fn size(&self) -> [usize; 2] {
        [self.width, self.height]
    }

    /// White columns are added at the right, up to this width.
    pub fn widened(self, width: usize) -> Self {
        if width <= self.width || self.width == 0 {
            return self;
        }
        let mut rgb = vec![255; width * self.height * 3];
        let rows = self.rgb.chunks_exact(self.width * 3);
        for (to, row) in rgb.chunks_exact_mut(width * 3).zip(rows) {
            to[..row.len()].copy_from_slice(row);
        }
        Self { width, rgb, ..self }
    }

    /// Every pixel becomes `factor` x `factor` pixels.
    pub fn enlarged(self, factor: usize) -> Self {
        let (width, height) = (self.width * factor, self.height * factor);
        let mut rgb = Vec::with_capacity(width * height * 3);
        for y in 0..height {
            for x in 0..width {
                let i = (y / factor * self.width + x / factor) * 3;
                rgb.extend_from_slice(&self.rgb[i..i + 3]);
            }
        }
        Self {
            width,
            height,
            rgb,
            ..self
        }
    }

    /// Draws a line between two positions in pixels (row 0 at the top), clipped to the picture.
    pub fn line(&mut self, from: [f64; 2], to: [f64; 2], colour: [u8; 3]) {
        let length = (to[0] - from[0]).hypot(to[1] - from[1]);
        if !length.is_finite() || length > 1e5 {
            return;
        }
        let steps = (length * 2.0).ceil().max(1.0) as usize;
        for i in 0..=steps {
            let t = i as f64 / steps as f64;
            let x = (from[0] + t * (to[0] - from[0])).floor();
            let y = (from[1] + t * (to[1] - from[1])).floor();
            if x >= 0.0 && y >= 0.0 && x < self.width as f64 && y < self.height as f64 {
                let at = (y as usize * self.width + x as usize) * 3;
                self.rgb[at..at + 3].copy_from_slice(&colour);
            }
        }
    }

    /// Draws a filled disc.
    pub fn dot(&mut self, centre: [f64; 2], radius: f64, colour: [u8; 3]) {
        // Casts to integers saturate: nothing is drawn beyond the edges.
        let span = |c: f64, n: usize| (c - radius) as usize..n.min((c + radius + 1.0) as usize);
        for y in span(centre[1], self.height) {
            for x in span(centre[0], self.width) {
                let d = (x as f64 + 0.5 - centre[0]).hypot(y as f64 + 0.5 - centre[1]);
                if d <= radius {
                    let at = (y * self.width + x) * 3;
                    self.rgb[at..at + 3].copy_from_slice(&colour);
                }
            }
        }
    }
}

/// Panels with their labels, `columns` in a row, as a PNG file.
///
/// # Errors
/// Those of the drawing library.
pub fn grid(columns: usize, panels: &[Panel]) -> Result<Vec<u8>> {
    register_font();
    const GAP: usize = 8;
    const LABEL: usize = 26;
    let columns = columns.clamp(1, panels.len().max(1));
    let rows = panels.len().div_ceil(columns);
    let cell_w = panels.iter().map(|p| p.width).max().unwrap_or(1) + GAP;
    let cell_h = panels.iter().map(|p| p.height).max().unwrap_or(1) + GAP + LABEL;
    let (width, height) = (columns * cell_w + GAP, rows * cell_h + GAP);
    let size = (width as u32, height as u32);
    let mut pixels = vec![255u8; width * height * 3];
    let corner = |i: usize| (GAP + i % columns * cell_w, GAP + i / columns * cell_h);
    {
        let area = BitMapBackend::with_buffer(&mut pixels, size).into_drawing_area();
        for (i, p) in panels.iter().enumerate() {
            let (x, y) = corner(i);
            // Long labels shrink to the width of their picture.
            let mut points = 17.0;
            let wide = |points: f64| -> Result<u32> {
                Ok(area
                    .estimate_text_size(&p.label, &(FONT, points).into_text_style(&area))?
                    .0)
            };
            while points > 9.0 && wide(points)? > cell_w as u32 - 2 {
                points -= 1.0;
            }
            let style = (FONT, points).into_text_style(&area);
            area.draw_text(&p.label, &style, (x as i32, y as i32 + 2))?;
        }
        area.present()?;
    }
    for (i, p) in panels.iter().enumerate() {
        let (x, y) = corner(i);
        // A frame one pixel wide, for pictures that are white.
        for row in 0..p.height + 2 {
            let at = ((y + LABEL + row - 1) * width + x - 1) * 3;
            pixels[at..at + (p.width + 2) * 3].fill(190);
        }
        for (row, line) in p.rgb.chunks_exact((p.width * 3).max(1)).enumerate() {
            let at = ((y + LABEL + row) * width + x) * 3;
            pixels[at..at + line.len()].copy_from_slice(line);
        }
    }
    encode_png(&pixels, size)
}

pub(crate) fn encode_png(rgb: &[u8], (width, height): (u32, u32)) -> Result<Vec<u8>> {
    let mut png = Cursor::new(Vec::new());
    image::write_buffer_with_format(
        &mut png,
        rgb,
        width,
        height,
        image::ExtendedColorType::Rgb8,
        image::ImageFormat::Png,
    )?;
    Ok(png.into_inner())
}

/// The sRGB transfer curve, in 8 bits.
fn srgb(v: f64) -> u8 {
    let v = v.clamp(0.0, 1.0);
    let e = if v <= 0.003_130_8 {
        12.92 * v
    } else {
        1.055 * v.powf(1.0 / 2.4) - 0.055
    };
    (e * 255.0).round() as u8
}

/// The viridis colour map, interpolated between nine of its colours.
fn viridis(t: f64) -> [u8; 3] {
    const STOPS: [[f64; 3]; 9] = [
        [68.0, 1.0, 84.0],
        [71.0, 44.0, 122.0],
        [59.0, 81.0, 139.0],
        [44.0, 113.0, 142.0],
        [33.0, 144.0, 141.0],
        [39.0, 173.0, 129.0],
        [92.0, 200.0, 99.0],
        [170.0, 220.0, 50.0],
        [253.0, 231.0, 37.0],
    ];
    let t = if t.is_nan() { 0.0 } else { t.clamp(0.0, 1.0) } * 8.0;
    let i = (t as usize).min(7);
    let f = t - i as f64;
    std::array::from_fn(|c| (STOPS[i][c] + f * (STOPS[i + 1][c] - STOPS[i][c])).round() as u8)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn charts_and_grids_are_drawn_whatever_the_numbers() {
        let bad = [f64::NAN, f64::INFINITY, -1.0, 0.0, 1e-300, 1e300];
        let points = bad.iter().flat_map(|&x| bad.iter().map(move |&y| (x, y)));
        for chart in [
            LineChart::new("empty", "x", "y"),
            LineChart::new("empty", "x", "y").log_x().log_y(),
            LineChart::new("one point", "x", "y").measured("a", [(1.0, 1.0)]),
            LineChart::new("bad", "x", "y")
                .log_x()
                .log_y()
                .line("a", points),
        ] {
            assert!(chart.png().is_ok());
            assert!(chart.svg().is_ok_and(|s| s.starts_with("<svg")));
        }
        let panels = [
            Panel::signed("signed", 2, &[f64::NAN, 1.0, -1.0, 0.0], None),
            Panel::false_colour("false", 2, &[f64::NAN, 1.0, 5.0, 0.0], 0.0, 0.0),
            Panel::tonemapped("", &Image::new(3, 1), 1.0).enlarged(20),
        ];
        assert!(grid(2, &panels).is_ok());
        assert!(grid(2, &[]).is_ok());
    }

    /// Numbers below the first power of ten as well, and not too many.
    #[test]
    fn logarithmic_axes_have_numbers() {
        assert_eq!(ticks(&(0.012..0.4)), [0.02, 0.05, 0.1, 0.2]);
        assert_eq!(ticks(&(0.9..1.1)), [1.0]);
        assert_eq!(ticks(&(1e-7..2.0)).len(), 8);
        assert!(ticks(&(1e-100..1e100)).len() > 6);
        let chart = LineChart::new("", "", "").log_x().log_y();
        let svg = chart
            .measured("", [(0.02, 0.9), (0.08, 1.1)])
            .svg()
            .unwrap();
        let text = |line: &str| line.trim().parse::<f64>().ok();
        let numbers: Vec<f64> = svg.lines().filter_map(text).collect();
        for number in [0.02, 0.05, 0.1, 1.0] {
            assert!(numbers.contains(&number), "{number} among {numbers:?}");
        }
    }

    #[test]
    fn a_logarithmic_axis_has_no_zero() {
        let chart = LineChart::new("", "", "").log_x().log_y();
        let chart = chart.measured("", [(1.0, 0.0), (2.0, 0.0), (3.0, 5.0)]);
        for (low, high) in [(0.0, 1.0), (-1.0, 1.0), (f64::NAN, 1.0), (2.0, 1.0)] {
            let chart = chart.clone().x_range(low, high).y_range(low, high);
            assert_eq!(
                chart.range(chart.y_range, true, |p| p.1),
                chart.range(None, true, |p| p.1)
            );
            assert!(chart.svg().is_ok());
        }
    }

    #[test]
    fn short_numbers() {
        let cases = [
            (0.0, "0"),
            (0.25, "0.25"),
            (1e-6, "1e-6"),
            (-3.5, "-3.5"),
            (1e6, "1e6"),
        ];
        for (v, text) in cases {
            assert_eq!(number(v), text);
        }
        assert_eq!(number(1.25e-4), "1.25e-4");
    }
}
