//! Percent-encoding, as in URIs.

/// Replaces `%20` and the like by their characters, U+FFFD if they are not UTF-8; anything else stays as it is.
pub fn percent_decoded(text: &str) -> String {
    let bytes = text.as_bytes();
    let digit = |at: usize| bytes.get(at).and_then(|byte| char::from(*byte).to_digit(16));
    let mut out = Vec::with_capacity(bytes.len());
    let mut at = 0;
    while at < bytes.len() {
        match (bytes[at], digit(at + 1), digit(at + 2)) {
            (b'%', Some(high), Some(low)) => {
                out.push((16 * high + low) as u8);
                at += 3;
            }
            (byte, ..) => {
                out.push(byte);
                at += 1;
            }
        }
    }
    String::from_utf8_lossy(&out).into_owned()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_two_hexadecimal_digits_are_a_code() {
        assert_eq!(percent_decoded("a%20b%2e%zz%4"), "a b.%zz%4");
        assert_eq!(percent_decoded("%+5%-5%C3%a9%"), "%+5%-5\u{e9}%");
    }
}
