//! Bar charts in SVG.

use std::fmt::Write as _;

use super::row::Row;

/// Sizes in the chart, px: width of names, of the longest bar, of a number and of its spread; height of a row, of its
/// bar, and of the ends of the line that shows the spread; margin.
const NAMES: usize = 210;
const LONGEST: usize = 400;
const NUMBERS: usize = 90;
const SPREADS: usize = 60;
const ROW: usize = 28;
const BAR: usize = 18;
const CAP: usize = 8;
const MARGIN: usize = 16;

/// For light and dark backgrounds.
const STYLE: &str = "<style>
text { fill: #24292f; font: 13px sans-serif; }
rect { fill: #4a8fd0; }
path { stroke: #24292f; fill: none; }
@media (prefers-color-scheme: dark) { text { fill: #e6edf3; } path { stroke: #e6edf3; } }
</style>
";

/// A bar per row, from 0 dB, as long as its mean PSNR over the seeds. With several seeds a line reaches from one standard
/// deviation below the mean to one above.
pub fn psnr_chart(rows: &[Row]) -> String {
    let spreads: Vec<_> = rows.iter().map(|row| row.spread(|run| run.test.psnr)).collect();
    let end = |(mean, deviation): (f64, Option<f64>)| mean + deviation.unwrap_or(0.0);
    let largest = spreads.iter().map(|spread| end((spread.mean, spread.deviation))).fold(1.0, f64::max);
    let has_spread = spreads.iter().any(|spread| spread.deviation.is_some());
    let title = if has_spread {
        "PSNR of the held-out views, dB: mean and standard deviation over seeds"
    } else {
        "PSNR of the held-out views, dB"
    };
    let width = NAMES + LONGEST + NUMBERS + if has_spread { SPREADS } else { 0 };
    let height = ROW * (rows.len() + 1) + MARGIN;
    let mut svg = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"{width}\" height=\"{height}\" viewBox=\"0 0 {width} \
         {height}\" role=\"img\">\n<title>{title}</title>\n{STYLE}"
    );
    let middle = |row: usize| MARGIN / 2 + ROW * row + ROW / 2;
    let label = |x: f64, y: usize, anchor: &str, text: &str| {
        format!("<text x=\"{x:.1}\" y=\"{y}\" text-anchor=\"{anchor}\" dominant-baseline=\"central\">{text}</text>\n")
    };
    let length = |psnr: f64| LONGEST as f64 * psnr.max(0.0) / largest;
    svg += &label(NAMES as f64, middle(0), "start", title);
    for (index, (row, spread)) in rows.iter().zip(&spreads).enumerate() {
        let y = middle(index + 1);
        svg += &label((NAMES - 10) as f64, y, "end", row.label);
        let top = y - BAR / 2;
        _ = writeln!(svg, "<rect x=\"{NAMES}\" y=\"{top}\" width=\"{:.1}\" height=\"{BAR}\"/>", length(spread.mean));
        if let Some(deviation) = spread.deviation {
            let [from, to] = [-deviation, deviation].map(|by| NAMES as f64 + length(spread.mean + by));
            let top = y - CAP / 2;
            _ = writeln!(svg, "<path d=\"M{from:.1} {top}v{CAP}M{from:.1} {y}H{to:.1}M{to:.1} {top}v{CAP}\"/>");
        }
        let right = NAMES as f64 + length(end((spread.mean, spread.deviation)));
        svg += &label(right + 8.0, y, "start", &format!("{spread:.2}"));
    }
    svg + "</svg>\n"
}

#[cfg(test)]
mod tests {
    use super::super::row::tests::row;
    use super::*;

    /// Names of all elements, each of which must end where it should.
    fn elements(xml: &str) -> Vec<String> {
        let (mut open, mut all) = (Vec::new(), Vec::new());
        for tag in xml.split('<').skip(1) {
            let (tag, text) = tag.split_once('>').expect("a tag ends");
            assert!(!text.contains('>') && !text.contains('&'), "{text}");
            assert_eq!(tag.matches('"').count() % 2, 0, "{tag}");
            let name = tag.trim_start_matches('/').split([' ', '/']).next().unwrap().to_owned();
            if tag.starts_with('/') {
                assert_eq!(open.pop(), Some(name));
                continue;
            }
            assert!(!open.is_empty() || all.is_empty(), "one root");
            all.push(name.clone());
            if !tag.ends_with('/') {
                open.push(name);
            }
        }
        assert!(open.is_empty(), "{open:?}");
        all
    }

    fn count(svg: &str, name: &str) -> usize {
        elements(svg).iter().filter(|element| *element == name).count()
    }

    #[test]
    fn the_chart_is_well_formed_and_its_bars_are_as_long_as_the_psnr() {
        let svg = psnr_chart(&[row("full", &[28.0]), row("ges", &[14.0]), row("sh", &[-3.0])]);
        assert_eq!(["svg", "style", "rect", "text", "path"].map(|name| count(&svg, name)), [1, 1, 3, 1 + 2 * 3, 0]);
        assert!(svg.starts_with("<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"700\""));
        for part in ["width=\"400.0\"", "width=\"200.0\"", "width=\"0.0\"", ">full<", ">28.00<", ">-3.00<", "dark"] {
            assert!(svg.contains(part), "{part}: {svg}");
        }
        assert_eq!(elements(&psnr_chart(&[])), ["svg", "title", "style", "text"]);
    }

    #[test]
    fn a_line_shows_the_spread_over_seeds() {
        // mean 30 ± 2 and 16 ± 0 of at most 32
        let svg = psnr_chart(&[row("full", &[28.0, 30.0, 32.0]), row("sh", &[16.0; 3])]);
        assert_eq!(["rect", "path"].map(|name| count(&svg, name)), [2, 2]);
        for part in ["width=\"375.0\"", "M560.0 46v8M560.0 50H610.0M610.0 46v8", ">30.00 ± 2.00<", "x=\"618.0\""] {
            assert!(svg.contains(part), "{part}: {svg}");
        }
    }
}
