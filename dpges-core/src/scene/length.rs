//! Lengths as people write them.

/// Units and their metres.
const UNITS: [(&str, f64); 6] = [("mm", 1e-3), ("cm", 1e-2), ("km", 1e3), ("in", 0.0254), ("ft", 0.3048), ("m", 1.0)];

/// The metres of `text`, a positive number with a unit, such as `1.25m` or `3 ft`.
///
/// # Errors
/// A sentence that says what is wrong with it.
pub fn parse_metres(text: &str) -> Result<f64, String> {
    let wrong =
        |what: &str| Err(format!("{what}: write a positive number with mm, cm, m, km, in or ft, such as 1.25m"));
    let found = UNITS.iter().find_map(|(name, metres)| Some((text.trim().strip_suffix(name)?, metres)));
    let Some((digits, metres)) = found else {
        let number = text.trim().parse::<f64>().is_ok();
        return wrong(if number { "a unit is missing" } else { "this is no length" });
    };
    match digits.trim().parse::<f64>() {
        Ok(number) if number.is_finite() && number > 0.0 => Ok(number * metres),
        Ok(_) => wrong("a length is more than 0, and finite"),
        Err(_) => wrong("this is no length"),
    }
}

/// `length` in metres with four digits, in the unit that people would take.
pub fn in_words(length: f64) -> String {
    let (unit, metres) = match length.abs() {
        small if small < 0.01 => ("mm", 1e-3),
        small if small < 1.0 => ("cm", 1e-2),
        large if large >= 1000.0 => ("km", 1e3),
        _ => ("m", 1.0),
    };
    format!("{} {unit}", four_digits(length / metres))
}

/// A number with four significant digits, and no more than nine behind the point.
pub fn four_digits(number: f64) -> String {
    let digits = (3.0 - number.abs().max(1e-12).log10().floor()).clamp(0.0, 9.0) as usize;
    format!("{number:.digits$}")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lengths_have_a_number_and_a_unit() {
        let texts = ["1.25m", "125 cm", "1250mm", "0.00125 km", " 2ft", "10in", "1e-3m"];
        let metres = [1.25, 1.25, 1.25, 1.25, 0.6096, 0.254, 1e-3];
        for (text, expected) in texts.into_iter().zip(metres) {
            assert!((parse_metres(text).unwrap() - expected).abs() < 1e-12, "{text}");
        }
        for (text, reason) in [
            ("1.25", "unit is missing"),
            ("0m", "more than 0"),
            ("-1 m", "more than 0"),
            ("nanm", "more than 0"),
            ("infkm", "more than 0"),
            ("m", "no length"),
            ("", "no length"),
            ("1.25yd", "no length"),
            ("one m", "no length"),
        ] {
            let message = parse_metres(text).unwrap_err();
            assert!(message.contains(reason) && message.contains("such as 1.25m"), "{text}: {message}");
        }
    }

    #[test]
    fn words_take_the_unit_that_fits() {
        let words = [0.00125, 0.0254, 1.25, 12.0, 2500.0].map(in_words);
        assert_eq!(words, ["1.250 mm", "2.540 cm", "1.250 m", "12.00 m", "2.500 km"]);
    }

    #[test]
    fn numbers_have_four_digits() {
        assert_eq!([0.012345, 1.23456, 123.456, 123456.7].map(four_digits), ["0.01235", "1.235", "123.5", "123457"]);
        assert_eq!(four_digits(0.0), "0.000000000");
    }
}
