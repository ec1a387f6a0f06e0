//! Words and values of a USD text.

use std::str::FromStr;

use super::super::fault::{Fault, malformed};
use super::AGAIN;

/// A place in a text.
pub(super) struct Scan<'a> {
    text: &'a [u8],
    pub at: usize,
}

impl<'a> Scan<'a> {
    pub(super) fn new(text: &'a [u8]) -> Self {
        Self { text, at: 0 }
    }

    /// The fault at this place.
    pub(super) fn fault(&self, what: &str) -> Fault {
        let line = self.text[..self.at.min(self.text.len())].split(|b| *b == b'\n').count();
        malformed(format!("line {line}"), format!("{what}; {AGAIN}"))
    }

    /// The next byte that is neither space nor comment, without taking it.
    pub(super) fn peek(&mut self) -> Option<u8> {
        loop {
            match self.text.get(self.at)? {
                b'#' | b'/' => match self.comment(self.at) {
                    0 => return Some(b'/'),
                    length => self.at += length,
                },
                b if b.is_ascii_whitespace() || matches!(b, b';' | b',') => self.at += 1,
                b => return Some(*b),
            }
        }
    }

    /// Bytes of the comment that begins at this place of the text, without the end of its line; 0 if none begins there.
    fn comment(&self, at: usize) -> usize {
        let rest = &self.text[at..];
        if rest.starts_with(b"#") || rest.starts_with(b"//") {
            return rest.iter().position(|b| *b == b'\n').unwrap_or(rest.len());
        }
        let Some(block) = rest.strip_prefix(b"/*") else { return 0 };
        block.windows(2).position(|end| end == b"*/").map_or(rest.len(), |end| end + 4)
    }

    /// True if a line ends before the next word.
    pub(super) fn line_ends(&self) -> bool {
        let mut at = self.at;
        loop {
            match self.text.get(at) {
                None | Some(b'\n' | b'#' | b';') => return true,
                Some(b' ' | b'\t' | b'\r') => at += 1,
                Some(b'/') => match self.comment(at) {
                    0 => return false,
                    length => at += length,
                },
                Some(_) => return false,
            }
        }
    }

    /// The next word: a name with its colons, dots and brackets, a quoted text without its quotes, or one sign.
    pub(super) fn word(&mut self) -> Option<&'a [u8]> {
        let first = self.peek()?;
        if matches!(first, b'"' | b'\'' | b'@') {
            return Some(self.quoted(first));
        }
        let is_name = |b: &u8| b.is_ascii_alphanumeric() || *b >= 0x80 || b"_:.[]".contains(b);
        let rest = &self.text[self.at..];
        // A bracket opens a list unless it belongs to a type, as in `float[]`.
        let length = if matches!(first, b'[' | b']') {
            1
        } else {
            rest.iter().position(|b| !is_name(b)).unwrap_or(rest.len()).max(1)
        };
        self.at += length;
        Some(&rest[..length])
    }

    /// A text in quotes, or in three of them, in which a backslash hides the next byte.
    fn quoted(&mut self, quote: u8) -> &'a [u8] {
        let rest = &self.text[self.at..];
        let width = if rest.starts_with(&[quote; 3]) { 3 } else { 1 };
        let mut end = width;
        while end < rest.len() && !rest[end..].starts_with(&[quote; 3][..width]) {
            end += if rest[end] == b'\\' && quote != b'@' { 2 } else { 1 };
        }
        let end = end.min(rest.len());
        self.at += (end + width).min(rest.len());
        &rest[width.min(end)..end]
    }

    /// Passes over a value: a word, or a group in brackets with all that it holds.
    pub(super) fn pass(&mut self) -> Result<(), Fault> {
        let mut open = 0_usize;
        loop {
            let Some(first) = self.peek() else { return Err(self.fault("the text ends within a value")) };
            let quoted = matches!(first, b'"' | b'\'' | b'@');
            // A name takes brackets along that close its list.
            for byte in self.word().unwrap_or_default().iter().filter(|_| !quoted) {
                match byte {
                    b'(' | b'[' | b'{' => open += 1,
                    b')' | b']' | b'}' if open == 0 => return Err(self.fault("a bracket that was not opened")),
                    b')' | b']' | b'}' => open -= 1,
                    _ => {}
                }
            }
            if open == 0 {
                return Ok(());
            }
        }
    }

    /// The numbers of a value, whatever brackets group them.
    pub(super) fn numbers<T: FromStr>(&mut self) -> Result<Vec<T>, Fault> {
        let mut numbers = Vec::new();
        let mut open = 0_usize;
        loop {
            let Some(first) = self.peek() else { return Err(self.fault("the text ends within numbers")) };
            match first {
                b'(' | b'[' => open += 1,
                b')' | b']' => open = open.checked_sub(1).ok_or_else(|| self.fault("a bracket that was not opened"))?,
                _ => {
                    let rest = &self.text[self.at..];
                    let is_part = |b: &u8| b.is_ascii_alphanumeric() || matches!(b, b'+' | b'-' | b'.');
                    let length = rest.iter().position(|b| !is_part(b)).unwrap_or(rest.len());
                    let number = std::str::from_utf8(&rest[..length]).ok().and_then(|text| text.parse().ok());
                    numbers.push(number.ok_or_else(|| self.fault("no number where one is due"))?);
                    self.at += length - 1;
                }
            }
            self.at += 1;
            if open == 0 {
                return Ok(numbers);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn words_values_and_numbers() {
        let mut scan = Scan::new(
            b"def Xform \"a \\\" b\" # comment\n (x = [1, {}]) float[] y:z=[(1,-2.5e3),(inf,.5)] @p.usd@</a> '''q\n'''",
        );
        for word in ["def", "Xform", "a \\\" b"] {
            assert_eq!(scan.word(), Some(word.as_bytes()));
        }
        assert!(scan.line_ends());
        scan.pass().unwrap();
        assert_eq!(
            (scan.word(), scan.word(), scan.word()),
            (Some(&b"float[]"[..]), Some(&b"y:z"[..]), Some(&b"="[..]))
        );
        assert_eq!(scan.numbers::<f32>().unwrap(), [1.0, -2500.0, f32::INFINITY, 0.5]);
        assert_eq!(scan.word(), Some(&b"p.usd"[..]));
        for word in ["<", "/", "a", ">", "q\n"] {
            assert_eq!(scan.word(), Some(word.as_bytes()));
        }
        assert_eq!((scan.word(), scan.peek()), (None, None));
    }

    #[test]
    fn comments_are_no_content() {
        let mut scan = Scan::new(b"x // it's {\n/* \" [ */y/**/= [1, /* 2,\n*/ 3, // 4\n5/* */] </a> \"//\" / /* open");
        assert_eq!(scan.word(), Some(&b"x"[..]));
        assert!(scan.line_ends());
        assert_eq!(scan.word(), Some(&b"y"[..]));
        assert!(!scan.line_ends());
        assert_eq!(scan.word(), Some(&b"="[..]));
        assert_eq!(scan.numbers::<f32>().unwrap(), [1.0, 3.0, 5.0]);
        for word in ["<", "/", "a", ">", "//", "/"] {
            assert_eq!(scan.word(), Some(word.as_bytes()));
        }
        assert!(scan.line_ends());
        assert_eq!(scan.peek(), None);
    }

    #[test]
    fn broken_groups_are_faults() {
        for text in ["[1, 2", "((1)", ")", "\"", "(\"", "]", "", "[a", "{ '''"] {
            assert!(Scan::new(text.as_bytes()).pass().is_err() || text == "\"", "{text}");
            assert!(Scan::new(text.as_bytes()).numbers::<f32>().is_err(), "{text}");
        }
        assert_eq!(Scan::new(b"7 8").numbers::<f32>().unwrap(), [7.0]);
    }
}
