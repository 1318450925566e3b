//! Many small charts on one sheet, with one legend: the figures of a paper.

use std::error::Error;

use plotters::coord::Shift;
use plotters::coord::ranged1d::{AsRangedCoord, Ranged, ValueFormatter};
use plotters::prelude::*;
use plotters::style::text_anchor::{HPos, Pos, VPos};

use crate::chart::{FONT, encode_png, number, readable_font, register_font};

type Result<T> = std::result::Result<T, Box<dyn Error>>;

/// Size of one chart, pixels.
const CELL: (u32, u32) = (560, 380);
const TITLE_HEIGHT: u32 = 48;
const LEGEND_ROW: u32 = 30;
const MARGIN: u32 = 14;

/// How a curve looks, on the sheet and in its legend.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Look {
    /// Red, green, blue.
    pub colour: [u8; 3],
    /// Dashed, with rings instead of dots.
    pub dashed: bool,
    /// Whether the points of the curve are marked.
    pub marked: bool,
}

impl Look {
    /// A joined measurement.
    pub fn measured(colour: [u8; 3], dashed: bool) -> Self {
        Self {
            colour,
            dashed,
            marked: true,
        }
    }

    /// A known law: a dashed line without marks.
    pub fn law(colour: [u8; 3]) -> Self {
        Self {
            colour,
            dashed: true,
            marked: false,
        }
    }

    fn style(self) -> ShapeStyle {
        let [r, g, b] = self.colour;
        let width = if self.marked { 2 } else { 1 };
        RGBColor(r, g, b).stroke_width(width)
    }
}

/// What is wrong at a point.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Mark {
    /// A cross.
    Failed,
    /// A triangle: too few samples to tell.
    Unresolved,
}

/// Points, joined in their order.
#[derive(Clone, Debug)]
pub struct Curve {
    /// How it looks.
    pub look: Look,
    /// Where it goes.
    pub points: Vec<(f64, f64)>,
    /// Marked points.
    pub marks: Vec<((f64, f64), Mark)>,
}

/// One chart. Points that are not finite, or not positive on a logarithmic axis, or below the chart are
/// left out; those above it are drawn on its edge.
#[derive(Clone, Debug)]
pub struct Plot {
    /// Above it.
    pub title: String,
    /// Labels of the axes.
    pub axes: [String; 2],
    /// Whether the horizontal axis is logarithmic; the vertical one always is.
    pub log_x: bool,
    /// Horizontal range.
    pub x: [f64; 2],
    /// Vertical range.
    pub y: [f64; 2],
    /// Curves; laws first, so that measurements lie on top.
    pub curves: Vec<Curve>,
    /// Horizontal lines with labels.
    pub levels: Vec<(f64, String)>,
    /// Vertical lines with labels.
    pub places: Vec<(f64, String)>,
    /// Text in the top right corner, line by line.
    pub notes: Vec<String>,
}

/// Charts in rows of equal length, below a title, above a legend.
#[derive(Clone, Debug)]
pub struct Sheet {
    /// Above all.
    pub title: String,
    /// Charts in a row.
    pub columns: usize,
    /// Row by row.
    pub plots: Vec<Plot>,
    /// Names of looks.
    pub legend: Vec<(String, Look)>,
    /// Names of marks.
    pub marks: Vec<(String, Mark)>,
}

/// Entries of the legend in a row.
const LEGEND_COLUMNS: usize = 7;

impl Sheet {
    fn legend_rows(&self) -> u32 {
        (self.legend.len() + self.marks.len()).div_ceil(LEGEND_COLUMNS) as u32
    }

    fn size(&self) -> (u32, u32) {
        let columns = self.columns.max(1);
        let rows = self.plots.len().div_ceil(columns) as u32;
        (
            columns as u32 * CELL.0 + 2 * MARGIN,
            TITLE_HEIGHT + rows * CELL.1 + self.legend_rows() * LEGEND_ROW + 2 * MARGIN,
        )
    }

    /// As a PNG file.
    ///
    /// # Errors
    /// Those of the drawing library.
    pub fn png(&self) -> Result<Vec<u8>> {
        let size = self.size();
        let mut pixels = vec![255u8; (size.0 * size.1 * 3) as usize];
        self.draw(BitMapBackend::with_buffer(&mut pixels, size).into_drawing_area())?;
        encode_png(&pixels, size)
    }

    /// As an SVG file.
    ///
    /// # Errors
    /// Those of the drawing library.
    pub fn svg(&self) -> Result<String> {
        let mut text = String::new();
        self.draw(SVGBackend::with_string(&mut text, self.size()).into_drawing_area())?;
        Ok(readable_font(&text))
    }

    fn draw<DB: DrawingBackend>(&self, area: DrawingArea<DB, Shift>) -> Result<()>
    where
        DB::ErrorType: 'static,
    {
        register_font();
        area.fill(&WHITE)?;
        let (width, height) = self.size();
        let centred = (FONT, 28)
            .into_text_style(&area)
            .pos(Pos::new(HPos::Center, VPos::Top));
        area.draw_text(&self.title, &centred, (width as i32 / 2, MARGIN as i32))?;
        for (i, plot) in self.plots.iter().enumerate() {
            let (column, row) = ((i % self.columns) as u32, (i / self.columns) as u32);
            let left = MARGIN + column * CELL.0;
            let top = TITLE_HEIGHT + row * CELL.1;
            let cell = area
                .clone()
                .shrink((left as i32, top as i32), (CELL.0 as i32, CELL.1 as i32));
            plot.draw(&cell)?;
        }
        let top = (height - self.legend_rows() * LEGEND_ROW - MARGIN) as i32;
        let pitch = (width - 2 * MARGIN) as i32 / LEGEND_COLUMNS as i32;
        let place = |i: usize| {
            let (column, row) = (i % LEGEND_COLUMNS, i / LEGEND_COLUMNS);
            (
                MARGIN as i32 + 20 + column as i32 * pitch,
                top + row as i32 * LEGEND_ROW as i32 + 12,
            )
        };
        let label = (FONT, 20).into_text_style(&area);
        for (i, (text, look)) in self.legend.iter().enumerate() {
            let (x, y) = place(i);
            let style = look.style();
            if look.dashed {
                for k in 0..4 {
                    let from = x + k * 13;
                    area.draw(&PathElement::new([(from, y), (from + 8, y)], style))?;
                }
            } else {
                area.draw(&PathElement::new([(x, y), (x + 47, y)], style))?;
            }
            if look.marked {
                let dot = if look.dashed { style } else { style.filled() };
                area.draw(&Circle::new((x + 24, y), 4, dot))?;
            }
            area.draw_text(text, &label, (x + 58, y - 10))?;
        }
        for (i, (text, mark)) in self.marks.iter().enumerate() {
            let (x, y) = place(self.legend.len() + i);
            match mark {
                Mark::Failed => area.draw(&Cross::new((x + 24, y), 6, BLACK.stroke_width(2)))?,
                Mark::Unresolved => {
                    area.draw(&TriangleMarker::new((x + 24, y), 8, BLACK.stroke_width(1)))?;
                }
            }
            area.draw_text(text, &label, (x + 58, y - 10))?;
        }
        area.present()?;
        Ok(())
    }
}

impl Plot {
    fn draw<DB: DrawingBackend>(&self, area: &DrawingArea<DB, Shift>) -> Result<()>
    where
        DB::ErrorType: 'static,
    {
        let y = (self.y[0]..self.y[1]).log_scale();
        if self.log_x {
            self.draw_on(area, (self.x[0]..self.x[1]).log_scale(), y)
        } else {
            self.draw_on(area, self.x[0]..self.x[1], y)
        }
    }

    /// The point as it is drawn.
    fn shown(&self, &(x, y): &(f64, f64)) -> Option<(f64, f64)> {
        let finite = x.is_finite() && y.is_finite();
        let inside = x >= self.x[0] && x <= self.x[1] && y >= self.y[0];
        (finite && inside).then(|| (x, y.min(self.y[1])))
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
            .caption(&self.title, (FONT, 21))
            .margin(8)
            .x_label_area_size(44)
            .y_label_area_size(72)
            .build_cartesian_2d(x, y)?;
        chart
            .configure_mesh()
            .x_desc(&self.axes[0])
            .y_desc(&self.axes[1])
            .axis_desc_style((FONT, 18))
            .label_style((FONT, 15))
            .x_labels(7)
            .y_labels(8)
            .max_light_lines(1)
            .light_line_style(TRANSPARENT)
            .bold_line_style(RGBColor(228, 228, 228))
            .x_label_formatter(&|v| number(*v))
            .y_label_formatter(&|v| number(*v))
            .draw()?;
        let grey = RGBColor(110, 110, 110);
        let small = (FONT, 15).into_font().color(&grey);
        for (level, text) in &self.levels {
            let ends = [(self.x[0], *level), (self.x[1], *level)];
            chart.draw_series(DashedLineSeries::new(ends, 3, 4, grey.stroke_width(1)))?;
            let at = small.clone().pos(Pos::new(HPos::Right, VPos::Bottom));
            let label = Text::new(text.clone(), (self.x[1], *level), at);
            chart.draw_series([label])?;
        }
        for (place, text) in &self.places {
            let ends = [(*place, self.y[0]), (*place, self.y[1])];
            chart.draw_series(DashedLineSeries::new(ends, 3, 4, grey.stroke_width(1)))?;
            let at = small.clone().pos(Pos::new(HPos::Left, VPos::Bottom));
            let label = Text::new(format!(" {text}"), (*place, self.y[0]), at);
            chart.draw_series([label])?;
        }
        for curve in &self.curves {
            let points: Vec<_> = curve.points.iter().filter_map(|p| self.shown(p)).collect();
            let style = curve.look.style();
            let line = points.iter().copied();
            if curve.look.dashed {
                chart.draw_series(DashedLineSeries::new(line, 8, 5, style))?;
            } else {
                chart.draw_series(LineSeries::new(line, style))?;
            }
            if curve.look.marked {
                let dot = if curve.look.dashed {
                    style
                } else {
                    style.filled()
                };
                chart.draw_series(points.iter().map(|p| Circle::new(*p, 3, dot)))?;
            }
        }
        for curve in &self.curves {
            let colour = curve.look.style();
            for (p, mark) in &curve.marks {
                let Some(p) = self.shown(p) else {
                    continue;
                };
                match mark {
                    Mark::Failed => {
                        // A white rim, so that it stands out of curves of its colour.
                        chart.draw_series([Cross::new(p, 8, WHITE.stroke_width(5))])?;
                        let style = colour.color.stroke_width(3);
                        chart.draw_series([Cross::new(p, 7, style)])?;
                    }
                    Mark::Unresolved => {
                        chart.draw_series([TriangleMarker::new(p, 9, WHITE.filled())])?;
                        let style = colour.color.stroke_width(1);
                        chart.draw_series([TriangleMarker::new(p, 8, style)])?;
                    }
                }
            }
        }
        let (w, _) = area.dim_in_pixel();
        for (i, note) in self.notes.iter().enumerate() {
            let at = (FONT, 16)
                .into_text_style(area)
                .pos(Pos::new(HPos::Right, VPos::Top));
            area.draw_text(note, &at, (w as i32 - 16, 40 + 19 * i as i32))?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sheets_are_drawn_whatever_the_numbers() {
        let bad = [f64::NAN, f64::INFINITY, -1.0, 0.0, 1e-300, 1e300, 0.5];
        let points: Vec<_> = (bad.iter())
            .flat_map(|&x| bad.iter().map(move |&y| (x, y)))
            .collect();
        let curve = |look| Curve {
            look,
            marks: (points.iter().map(|p| (*p, Mark::Failed)))
                .chain(points.iter().map(|p| (*p, Mark::Unresolved)))
                .collect(),
            points: points.clone(),
        };
        let plot = |log_x| Plot {
            title: "a chart".into(),
            axes: ["x".into(), "y".into()],
            log_x,
            x: [1e-2, 1.0],
            y: [1e-3, 1e3],
            curves: vec![
                curve(Look::law([0; 3])),
                curve(Look::measured([200, 0, 0], true)),
                curve(Look::measured([0, 0, 200], false)),
            ],
            levels: vec![(1.0, "limit".into())],
            places: vec![(0.1, "here".into())],
            notes: vec!["a note".into()],
        };
        let sheet = Sheet {
            title: "a sheet".into(),
            columns: 2,
            plots: vec![plot(true), plot(false), plot(true)],
            legend: vec![("law".into(), Look::law([0; 3]))],
            marks: vec![
                ("failed".into(), Mark::Failed),
                ("?".into(), Mark::Unresolved),
            ],
        };
        assert!(sheet.png().is_ok());
        let svg = sheet.svg().unwrap();
        assert!(svg.starts_with("<svg") && svg.contains("a sheet"));
    }
}
