//! The results as one page that needs nothing else: no network, no scripts, figures as SVG.

mod anytime;
mod axis;
mod percentiles;
mod style;
mod success;
mod tables;

use std::fmt::Write as _;

use super::results::{Results, Run, WorkcellAge};
use super::selection::Size;

/// The page.
pub fn to_html(results: &Results) -> String {
    let view = View::of(results);
    let mut page = String::new();
    let title = "Quadrille: the paper's evaluation";
    let _ = write!(
        page,
        "<!doctype html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\">\n\
         <meta name=\"viewport\" content=\"width=device-width, initial-scale=1\">\n\
         <meta name=\"color-scheme\" content=\"light dark\">\n\
         <title>{title}</title>\n<style>{}</style>\n</head>\n<body>\n<main>\n<h1>{title}</h1>\n",
        style::CSS
    );
    page.push_str(&introduction(results));
    page.push_str("<h2>All figures</h2>\n");
    page.push_str(&tables::overview(&view));
    for family in &view.families {
        let _ = writeln!(page, "<h2>{}</h2>", escape(&family.name));
        page.push_str(&legend(&view));
        page.push_str("<div class=\"charts\">\n");
        for chart in percentiles::CHARTS {
            page.push_str(&percentiles::figure(&view, family, &chart));
        }
        page.push_str(&success::figure(&view, family));
        page.push_str("</div>\n<h3>Duration of the plan in hand over time</h3>\n<div class=\"charts\">\n");
        for size in &family.sizes {
            page.push_str(&anytime::figure(&view, family, size));
        }
        page.push_str("</div>\n");
    }
    page.push_str("<h2>Where the time to the first plan goes</h2>\n");
    page.push_str(&tables::phases(&view));
    page.push_str(&tables::remarks(results));
    page.push_str("</main>\n</body>\n</html>\n");
    page
}

/// Runs in the order in which they are shown.
struct View<'a> {
    results: &'a Results,
    families: Vec<Family>,
    /// Guidances, each with the colour of its place.
    guidances: Vec<String>,
}

/// A family and its sizes, small ones first.
struct Family {
    name: String,
    sizes: Vec<String>,
}

impl<'a> View<'a> {
    fn of(results: &'a Results) -> Self {
        let mut families: Vec<Family> = Vec::new();
        let mut guidances: Vec<String> = Vec::new();
        for run in &results.runs {
            let at = families.iter().position(|family| family.name == run.family).unwrap_or_else(|| {
                families.push(Family { name: run.family.clone(), sizes: Vec::new() });
                families.len() - 1
            });
            if !families[at].sizes.contains(&run.size) {
                families[at].sizes.push(run.size.clone());
            }
            if !guidances.contains(&run.guidance) {
                guidances.push(run.guidance.clone());
            }
        }
        for family in &mut families {
            family.sizes.sort_by_key(|size| size.parse::<Size>().ok());
        }
        Self { results, families, guidances }
    }

    /// The runs of one group.
    fn runs<'s>(&'s self, family: &'s Family, size: &'s str, guidance: &'s str) -> Vec<&'a Run> {
        let ours = |run: &&Run| run.family == family.name && run.size == size && run.guidance == guidance;
        self.results.runs.iter().filter(ours).collect()
    }
}

fn introduction(results: &Results) -> String {
    let (machine, setup) = (&results.machine, &results.setup);
    let memory = machine.memory_gb.map_or(String::new(), |gb| format!(", {gb} GB"));
    let threads =
        if setup.threads == 1 { "one thread".to_owned() } else { format!("{} threads", setup.threads) };
    let end = if setup.first_solution { ", ended at the first plan" } else { "" };
    let workcell = match setup.workcell {
        WorkcellAge::New => "nothing known of the workcell before a run",
        WorkcellAge::Known => "another arrangement of the same workcell planned before each run",
        WorkcellAge::Stored => {
            "another arrangement of the same workcell planned before, by a process that left a file"
        }
    };
    let mut text = format!(
        "<p>{} ({} processors{memory}, {}), Quadrille {}, {}.<br>\n\
         {} runs: {} trials each with sampled poses, {} s per run on {threads}{end}, {workcell}. Trial n has \
         scenario seed n and planner seed n. Every plan was judged; what the judge rejects does not count.</p>\n",
        escape(&machine.processor),
        machine.cores,
        escape(&machine.system),
        escape(&machine.version),
        escape(&results.conditions.started_at),
        results.runs.len(),
        setup.trials,
        setup.budget_s,
    );
    if let Some(share) = results.conditions.waited_share {
        let _ = writeln!(
            text,
            "<p>The runs waited {:.1} % of their time for a processor that another process had.</p>",
            100.0 * share
        );
    }
    text
}

/// The guidances and their colours, and how to read the marks.
fn legend(view: &View<'_>) -> String {
    let mut out = String::from("<p class=\"legend\">");
    for (index, guidance) in view.guidances.iter().enumerate() {
        let _ = write!(out, "<span><i class=\"key s{}\"></i>{}</span>", index % 4, escape(guidance));
    }
    out.push_str(
        "<span class=\"note\">bar: percentiles 25 to 75, line across: median, thin line: 10 to 90, \
         diamond: mean</span></p>\n",
    );
    out
}

/// A figure with its caption.
fn framed(caption: &str, svg: &str) -> String {
    format!("<figure>\n<figcaption>{}</figcaption>\n{svg}</figure>\n", escape(caption))
}

/// Text as HTML.
fn escape(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
}

/// Three digits that count, without noughts at the end of whole numbers.
fn digits(value: f64) -> String {
    if value == 0.0 || !value.is_finite() {
        return if value == 0.0 { "0".to_owned() } else { "–".to_owned() };
    }
    if value.fract() == 0.0 && value.abs() < 1e6 {
        return format!("{value:.0}");
    }
    let places = 2 - value.abs().log10().floor().clamp(-4.0, 2.0) as i32;
    format!("{value:.*}", usize::try_from(places).unwrap_or(0))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn three_digits_count() {
        for (value, text) in [
            (0.0, "0"),
            (6.0, "6"),
            (0.012_345, "0.0123"),
            (1.2345, "1.23"),
            (12.345, "12.3"),
            (123.45, "123"),
            (12_345.6, "12346"),
            (f64::INFINITY, "–"),
        ] {
            assert_eq!(digits(value), text);
        }
    }

    #[test]
    fn text_cannot_break_the_page() {
        assert_eq!(escape("<b a=\"1\">&"), "&lt;b a=&quot;1&quot;&gt;&amp;");
    }
}
