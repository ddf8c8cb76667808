//! Figures of several seeds, as Markdown.

/// Mean of some figures; `None` without any.
pub fn mean(figures: &[f64]) -> Option<f64> {
    (!figures.is_empty()).then(|| figures.iter().sum::<f64>() / figures.len() as f64)
}

/// Sample standard deviation; `None` of fewer than two.
pub fn deviation(figures: &[f64]) -> Option<f64> {
    let mean = mean(figures).filter(|_| figures.len() > 1)?;
    let squares: f64 = figures.iter().map(|figure| (figure - mean).powi(2)).sum();
    Some((squares / (figures.len() - 1) as f64).sqrt())
}

/// Mean ± standard deviation with 2 decimals, where there are any.
pub fn spread(figures: &[f64]) -> String {
    match (mean(figures), deviation(figures)) {
        (Some(mean), Some(deviation)) => format!("{mean:.2} ± {deviation:.2}"),
        (Some(mean), None) => format!("{mean:.2}"),
        (None, _) => "–".to_owned(),
    }
}

/// A table of `rows` below `columns`. The first column is text, the others numbers.
pub fn markdown(columns: &[&str], rows: &[Vec<String>]) -> String {
    let line = |cells: &[&str]| format!("| {} |\n", cells.join(" | "));
    let rule = format!("|---|{}\n", "---:|".repeat(columns.len().saturating_sub(1)));
    let body = rows.iter().map(|row| line(&row.iter().map(String::as_str).collect::<Vec<_>>()));
    line(columns) + &rule + &body.collect::<String>()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn figures_have_a_mean_and_from_two_on_a_spread() {
        assert_eq!((mean(&[]), deviation(&[1.0])), (None, None));
        assert_eq!((spread(&[]), spread(&[1.5])), ("–".to_owned(), "1.50".to_owned()));
        assert_eq!(spread(&[1.0, 2.0, 3.0]), "2.00 ± 1.00");
    }

    #[test]
    fn tables_have_a_rule_below_their_columns() {
        let table = markdown(&["a", "b", "c"], &[vec!["x".into(), "1".into(), "2".into()]]);
        assert_eq!(table, "| a | b | c |\n|---|---:|---:|\n| x | 1 | 2 |\n");
    }
}
