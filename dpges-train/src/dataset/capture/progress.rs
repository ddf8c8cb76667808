//! How far programs are, by what they say.

/// Done and total, in photographs, pairs of blocks of photographs or frames, by a line of COLMAP's or GLOMAP's output.
/// `photographs` is how many there are. `None` for lines about something else.
pub(super) fn of_colmap(line: &str, photographs: usize) -> Option<(usize, usize)> {
    if let Some((_, rest)) = line.split_once("Processed file [") {
        return fraction(rest);
    }
    // these begin what they name
    let begun = |(done, total): (usize, usize)| (done.saturating_sub(1), total);
    if let Some((_, rest)) = line.split_once("ing image [") {
        return fraction(rest).map(begun);
    }
    if let Some((_, rest)) = line.split_once("ing block [") {
        let (row, column) = rest.split_once(", ")?;
        let ((row, rows), (column, columns)) = (fraction(row)?, fraction(column)?);
        return Some((row.checked_sub(1)? * columns + column.checked_sub(1)?, rows * columns));
    }
    let (_, rest) = line.split_once("Registering image #")?;
    let (_, rest) = rest.split_once('(')?;
    let placed = number(rest.trim_start_matches("num_reg_frames="))?;
    Some((placed.min(photographs), photographs))
}

/// Frames so far, by a line of ffmpeg's `-progress`.
pub(super) fn of_ffmpeg(line: &str) -> Option<usize> {
    number(line.strip_prefix("frame=")?.trim_start())
}

/// `a/b` at the beginning of `text`.
fn fraction(text: &str) -> Option<(usize, usize)> {
    let (done, total) = text.split_once('/')?;
    Some((number(done)?, number(total)?))
}

/// The digits at the beginning of `text`.
fn number(text: &str) -> Option<usize> {
    let end = text.find(|c: char| !c.is_ascii_digit()).unwrap_or(text.len());
    text[..end].parse().ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lines_of_old_and_new_versions_are_understood() {
        let cases = [
            ("Processed file [12/49]", Some((12, 49))),
            ("I20260101 10:00:00.000000 1 feature_extraction.cc:254] Processed file [1/49]", Some((1, 49))),
            ("Matching block [1/3, 2/3] in 34.321s", Some((1, 9))),
            ("I20260101 10:00:00.000000 1 pairing.cc:214] Processing block [3/3, 3/3]", Some((8, 9))),
            ("Matching image [7/49] in 1.5s", Some((6, 49))),
            ("Processing image [7/49]", Some((6, 49))),
            ("Registering image #31 (3)", Some((3, 49))),
            (
                "I20260101 10:00:00.000000 1 incremental_pipeline.cc:1] Registering image #31 (num_reg_frames=7)",
                Some((7, 49)),
            ),
            ("  => Image sees 121 / 473 points", None),
            ("Matching block [x/3, 2/3]", None),
            ("Processed file [99999999999999999999999/1]", None),
            ("", None),
        ];
        for (line, expected) in cases {
            assert_eq!(of_colmap(line, 49), expected, "{line}");
        }
        assert_eq!(of_colmap("Registering image #1 (50)", 49), Some((49, 49)));
    }

    #[test]
    fn frames_are_counted() {
        assert_eq!(of_ffmpeg("frame=120"), Some(120));
        assert_eq!(of_ffmpeg("frame=  7"), Some(7));
        assert_eq!(of_ffmpeg("fps=12.5"), None);
    }
}
