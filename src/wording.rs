//! Words that messages share: counts, sizes, and refusals of unknown names.

use std::fmt::Display;

/// An enum whose variants have names, in messages, on the command line and in files: their list, [`Display`] and `name`.
macro_rules! named {
    ($(#[$attribute:meta])* $seen:vis enum $Name:ident { $($(#[$of_variant:meta])* $Variant:ident = $text:literal,)* }) => {
        $(#[$attribute])*
        $seen enum $Name { $($(#[$of_variant])* $Variant,)* }

        impl $Name {
            /// All of them, in their order.
            pub const ALL: [Self; [$($text),*].len()] = [$(Self::$Variant),*];

            /// Its name in messages, in files and on the command line.
            pub const fn name(self) -> &'static str {
                match self {
                    $(Self::$Variant => $text,)*
                }
            }
        }

        impl std::fmt::Display for $Name {
            fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
                f.pad(self.name())
            }
        }
    };
}
pub(crate) use named;

/// `1 photo`, `3 photos`: a count, and a noun whose plural ends in s.
pub fn counted<N: Copy + Display + PartialEq + From<u8>>(n: N, noun: &str) -> String {
    let ending = if n == N::from(1) { "" } else { "s" };
    format!("{n} {noun}{ending}")
}

/// The first `most` characters of a foreign text, escaped, for a message.
pub(crate) fn shown(text: &str, most: usize) -> String {
    text.chars().take(most).flat_map(char::escape_debug).collect()
}

/// `60 MiB`, the unit of `--memory-budget 60M`; with one digit below ten.
pub fn mebibytes(bytes: u64) -> String {
    let mebi = bytes as f64 / f64::from(1 << 20);
    format!("{mebi:.*} MiB", usize::from(mebi < 9.95))
}

/// Largest size in bytes: no model is larger.
const LARGEST: f64 = 1e15;

/// `5MB`: a number and a unit, of 1000 (kB, MB, GB) or 1024 (KiB, MiB, GiB), or `B`.
pub fn file_size(text: &str) -> Result<u64, String> {
    let at = text.find(|c: char| c.is_ascii_alphabetic()).unwrap_or(text.len());
    let (number, unit) = text.split_at(at);
    let unit = match unit.to_ascii_lowercase().as_str() {
        "b" => 1.0,
        "kb" => 1e3,
        "mb" => 1e6,
        "gb" => 1e9,
        "tb" => 1e12,
        "kib" => 1024.0,
        "mib" => 1048576.0,
        "gib" => 1073741824.0,
        "tib" => 1099511627776.0,
        "" => return Err("write a size with its unit, such as 5MB, 800kB or 4.5MiB".to_owned()),
        _ => return Err("write a size with one of the units B, kB, MB, GB, TB, KiB, MiB, GiB and TiB".to_owned()),
    };
    let number =
        number.trim().parse::<f64>().map_err(|_| "write a number with its unit, such as 5MB or 4.5MiB".to_owned())?;
    let bytes = Some((number * unit).floor()).filter(|b| *b >= 1.0);
    bytes.map(|b| b.min(LARGEST) as u64).ok_or_else(|| "write a size above 0, such as 5MB, 800kB or 4.5MiB".to_owned())
}

/// The refusal of a name that is not known: `'abc' is not a selector; possible values: gnso, css`. `what` has its article.
pub fn unknown<S: AsRef<str>>(name: &str, what: &str, known: impl IntoIterator<Item = S>) -> String {
    let mut text = format!("'{name}' is not {what}; possible values: ");
    for (i, known) in known.into_iter().enumerate() {
        text += if i == 0 { "" } else { ", " };
        text += known.as_ref();
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_is_singular_and_all_else_plural() {
        assert_eq!(counted(1_usize, "photo"), "1 photo");
        assert_eq!(counted(0_usize, "photo"), "0 photos");
        assert_eq!(counted(21_u32, "held-out view"), "21 held-out views");
    }

    #[test]
    fn foreign_texts_are_cut_and_escaped() {
        assert_eq!((shown("a\n\u{1b}b", 3), shown("a", 3)), ("a\\n\\u{1b}".to_owned(), "a".to_owned()));
    }

    #[test]
    fn bytes_are_told_in_the_unit_of_budgets() {
        let told = [40_000, 9 << 20, 10_450_000, 2 << 30].map(mebibytes);
        assert_eq!(told, ["0.0 MiB", "9.0 MiB", "10 MiB", "2048 MiB"]);
    }

    #[test]
    fn sizes_have_a_least_and_no_greatest() {
        assert_eq!((file_size("4.5MB"), file_size("1KiB")), (Ok(4_500_000), Ok(1024)));
        assert_eq!((file_size("2000TB"), file_size("1TB")), (Ok(1_000_000_000_000_000), Ok(1_000_000_000_000)));
        for small in ["0MB", "0.9B", "-5MB"] {
            assert!(file_size(small).unwrap_err().contains("above 0"), "{small}");
        }
    }

    #[test]
    fn unknown_names_are_refused_with_all_that_are_known() {
        assert_eq!(
            unknown("abc", "a selector", ["gnso", "css"]),
            "'abc' is not a selector; possible values: gnso, css"
        );
    }
}
