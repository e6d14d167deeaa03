//! How many trials were solved.

use super::axis::{Canvas, Scale};
use super::{Family, View, escape, framed};

/// Bars of the share of solved trials, with the numbers above.
pub(super) fn figure(view: &View<'_>, family: &Family) -> String {
    let caption = "Solved trials (%)";
    let mut canvas = Canvas::new(caption, Scale::from_zero(108.0));
    for (index, size) in family.sizes.iter().enumerate() {
        let (middle, width) = canvas.band(index, family.sizes.len(), size);
        let count = view.guidances.len();
        let room = (0.8 * width / count as f64).min(34.0);
        for (place, guidance) in view.guidances.iter().enumerate() {
            let runs = view.runs(family, size, guidance);
            if runs.is_empty() {
                continue;
            }
            let solved = runs.iter().filter(|run| run.solved).count();
            let x = middle + (place as f64 - 0.5 * (count as f64 - 1.0)) * room;
            let (top, floor) = (canvas.y(100.0 * solved as f64 / runs.len() as f64), canvas.floor());
            let bar = (0.7 * room).clamp(5.0, 20.0);
            canvas.add(&format!(
                "<g class=\"s{}\"><title>{size} {}: {solved} of {} solved</title>\
                 <rect class=\"box\" x=\"{:.1}\" y=\"{top:.1}\" width=\"{bar:.1}\" height=\"{:.1}\"/>\
                 <text x=\"{x:.1}\" y=\"{:.1}\" text-anchor=\"middle\">{solved}</text></g>",
                place % 4,
                escape(guidance),
                runs.len(),
                x - 0.5 * bar,
                floor - top,
                top - 4.0,
            ));
        }
    }
    framed(caption, &canvas.finish())
}
