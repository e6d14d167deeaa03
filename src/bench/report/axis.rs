//! Scales, grids and the frame of a chart.

use std::fmt::Write as _;

use super::{digits, escape};

/// Width of a chart in its own units.
pub(super) const WIDTH: f64 = 540.0;
/// Height of a chart.
pub(super) const HEIGHT: f64 = 240.0;
const LEFT: f64 = 48.0;
const RIGHT: f64 = 8.0;
const TOP: f64 = 10.0;
const BOTTOM: f64 = 28.0;

/// A range of values along one direction of a chart.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Scale {
    from: f64,
    to: f64,
    logarithmic: bool,
}

impl Scale {
    /// From 0 to a little above `most`.
    pub(super) fn from_zero(most: f64) -> Self {
        let to = if most > 0.0 && most.is_finite() { 1.05 * most } else { 1.0 };
        Self { from: 0.0, to, logarithmic: false }
    }

    /// Around `least` and `most`, which must be finite.
    pub(super) fn around(least: f64, most: f64) -> Self {
        let margin = (0.05 * (most - least)).max(1e-3 * most.abs()).max(1e-9);
        Self { from: least - margin, to: most + margin, logarithmic: false }
    }

    /// In equal ratios around `least` and `most`, which must be positive.
    pub(super) fn ratios(least: f64, most: f64) -> Self {
        let least = if least > 0.0 && least.is_finite() { least } else { 1e-3 };
        let most = if most > least && most.is_finite() { most } else { least };
        Self { from: least / 1.2, to: most * 1.2, logarithmic: true }
    }

    /// Where a value lies, from 0 to 1; what is outside goes to the nearer end.
    fn place(&self, value: f64) -> f64 {
        let place = if self.logarithmic {
            (value / self.from).ln() / (self.to / self.from).ln()
        } else {
            (value - self.from) / (self.to - self.from)
        };
        place.clamp(0.0, 1.0)
    }

    /// The value at a place from 0 to 1.
    pub(super) fn value(&self, place: f64) -> f64 {
        if self.logarithmic {
            self.from * (self.to / self.from).powf(place)
        } else {
            self.from + place * (self.to - self.from)
        }
    }

    /// Round values within the range, a handful.
    fn ticks(&self) -> Vec<f64> {
        let inside = |value: &f64| (self.from..=self.to).contains(value);
        if self.logarithmic {
            let decades = self.from.log10().floor() as i32..=self.to.log10().ceil() as i32;
            let count = (self.to / self.from).log10();
            let parts: &[f64] = match count {
                3.0.. => &[1.0],
                0.8.. => &[1.0, 2.0, 5.0],
                _ => &[1.0, 1.2, 1.5, 2.0, 2.5, 3.0, 4.0, 5.0, 6.0, 8.0],
            };
            let all = decades.flat_map(|decade| parts.iter().map(move |part| part * 10f64.powi(decade)));
            return all.filter(inside).collect();
        }
        let rough = (self.to - self.from) / 6.0;
        let decade = 10f64.powf(rough.log10().floor());
        let step = [1.0, 2.0, 5.0, 10.0].map(|part| part * decade).into_iter().find(|step| *step >= rough);
        let step = step.unwrap_or(10.0 * decade);
        let first = (self.from / step).ceil() as i64;
        (first..).map(|k| k as f64 * step).take_while(|value| *value <= self.to).collect()
    }
}

/// A round value, without noughts at its end.
fn round(value: f64) -> String {
    let text = digits(value);
    if text.contains('.') { text.trim_end_matches('0').trim_end_matches('.').to_owned() } else { text }
}

/// A chart that is being drawn.
pub(super) struct Canvas {
    svg: String,
    vertical: Scale,
}

impl Canvas {
    /// A frame with the vertical grid lines and their values.
    pub(super) fn new(title: &str, vertical: Scale) -> Self {
        let mut svg = String::new();
        let _ = writeln!(
            svg,
            "<svg viewBox=\"0 0 {WIDTH} {HEIGHT}\" role=\"img\" aria-label=\"{}\">",
            escape(title)
        );
        let mut canvas = Self { svg, vertical };
        for value in vertical.ticks() {
            let y = canvas.y(value);
            canvas.add(&format!(
                "<line class=\"grid\" x1=\"{LEFT}\" x2=\"{}\" y1=\"{y:.1}\" y2=\"{y:.1}\"/>\
                 <text x=\"{}\" y=\"{:.1}\" text-anchor=\"end\">{}</text>",
                WIDTH - RIGHT,
                LEFT - 6.0,
                y + 4.0,
                round(value)
            ));
        }
        let floor = HEIGHT - BOTTOM;
        canvas.add(&format!(
            "<line class=\"axis\" x1=\"{LEFT}\" x2=\"{}\" y1=\"{floor}\" y2=\"{floor}\"/>",
            WIDTH - RIGHT
        ));
        canvas
    }

    /// Adds elements.
    pub(super) fn add(&mut self, elements: &str) {
        self.svg.push_str(elements);
        self.svg.push('\n');
    }

    /// Where a value is drawn.
    pub(super) fn y(&self, value: f64) -> f64 {
        HEIGHT - BOTTOM - self.vertical.place(value) * (HEIGHT - BOTTOM - TOP)
    }

    /// Where the bottom is.
    pub(super) fn floor(&self) -> f64 {
        HEIGHT - BOTTOM
    }

    /// The middle of band `index` of `count`, and the width of each; with its name below.
    pub(super) fn band(&mut self, index: usize, count: usize, name: &str) -> (f64, f64) {
        let width = (WIDTH - LEFT - RIGHT) / count.max(1) as f64;
        let middle = LEFT + (index as f64 + 0.5) * width;
        self.below(middle, name);
        (middle, width)
    }

    /// Where a value of a horizontal scale is drawn.
    pub(super) fn x(&self, scale: &Scale, value: f64) -> f64 {
        LEFT + scale.place(value) * (WIDTH - LEFT - RIGHT)
    }

    /// Marks the values of a horizontal scale.
    pub(super) fn horizontal(&mut self, scale: &Scale) {
        for value in scale.ticks() {
            let x = self.x(scale, value);
            self.below(x, &round(value));
        }
    }

    /// Text below the axis.
    fn below(&mut self, x: f64, text: &str) {
        let y = HEIGHT - BOTTOM + 17.0;
        self.add(&format!("<text x=\"{x:.1}\" y=\"{y}\" text-anchor=\"middle\">{}</text>", escape(text)));
    }

    /// The finished chart.
    pub(super) fn finish(mut self) -> String {
        self.svg.push_str("</svg>\n");
        self.svg
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ticks_are_round_and_within() {
        assert_eq!(Scale::from_zero(10.0).ticks(), [0.0, 2.0, 4.0, 6.0, 8.0, 10.0]);
        assert_eq!(Scale::ratios(0.05, 2.0).ticks(), [0.05, 0.1, 0.2, 0.5, 1.0, 2.0]);
        assert_eq!(Scale::ratios(0.001, 30.0).ticks(), [0.001, 0.01, 0.1, 1.0, 10.0]);
        let around = Scale::around(11.2, 15.9).ticks();
        assert_eq!(around, [11.0, 12.0, 13.0, 14.0, 15.0, 16.0]);
        for odd in [Scale::ratios(0.0, f64::NAN), Scale::from_zero(0.0), Scale::around(3.0, 3.0)] {
            assert!(odd.ticks().len() < 20);
        }
    }

    #[test]
    fn round_values_are_written_as_such() {
        for (value, text) in [(0.05, "0.05"), (0.1 + 0.2, "0.3"), (20.0, "20"), (2.5, "2.5")] {
            assert_eq!(round(value), text);
        }
    }

    #[test]
    fn places_and_values_are_inverse() {
        for scale in [Scale::from_zero(7.0), Scale::ratios(0.01, 30.0), Scale::around(-2.0, 5.0)] {
            for place in [0.0, 0.25, 1.0] {
                assert!((scale.place(scale.value(place)) - place).abs() < 1e-12);
            }
        }
        assert_eq!(Scale::from_zero(1.0).place(9.0), 1.0);
    }
}
