//! The secret that a page needs where others can reach the port.

use std::fmt;

use axum::http::{HeaderMap, Uri, header};

/// Random bytes of a token.
const BYTES: usize = 16;

/// A secret in hexadecimal, made at the start and printed once.
#[derive(Clone)]
pub struct Token(String);

/// Logs show no secret.
impl fmt::Debug for Token {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("Token")
    }
}

/// The system has no randomness to give.
#[derive(Debug, thiserror::Error)]
#[error("no random numbers for the page's token: {0}")]
pub struct NoToken(getrandom::Error);

impl Token {
    /// A new one.
    ///
    /// # Errors
    /// [`NoToken`].
    pub fn random() -> Result<Self, NoToken> {
        let mut bytes = [0; BYTES];
        getrandom::fill(&mut bytes).map_err(NoToken)?;
        Ok(Self(bytes.iter().map(|byte| format!("{byte:02x}")).collect()))
    }

    /// As it stands in the page's address.
    pub fn text(&self) -> &str {
        &self.0
    }

    /// Whether a request knows it: as `Authorization: Bearer`, or as `token` in its query, since a browser sends no
    /// header with a WebSocket.
    pub(crate) fn is_known(&self, uri: &Uri, headers: &HeaderMap) -> bool {
        let bearer = headers.get(header::AUTHORIZATION).and_then(|value| value.to_str().ok());
        let bearer = bearer.and_then(|value| value.strip_prefix("Bearer "));
        let query = uri.query().unwrap_or("").split('&').find_map(|part| part.strip_prefix("token="));
        [bearer, query].into_iter().flatten().any(|given| same(given.as_bytes(), self.0.as_bytes()))
    }
}

/// Compares in a time that depends on the lengths alone.
fn same(given: &[u8], secret: &[u8]) -> bool {
    let differs = given.iter().zip(secret).fold(0, |differs, (a, b)| std::hint::black_box(differs | (a ^ b)));
    given.len() == secret.len() && differs == 0
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_token_is_known_by_header_or_query_and_whole() {
        let token = Token::random().unwrap();
        assert_eq!(token.text().len(), 32);
        assert_ne!(token.text(), Token::random().unwrap().text());
        let knows = |query: &str, bearer: &str| {
            let mut headers = HeaderMap::new();
            if !bearer.is_empty() {
                headers.insert(header::AUTHORIZATION, bearer.parse().unwrap());
            }
            token.is_known(&format!("http://localhost/live{query}").parse().unwrap(), &headers)
        };
        let text = token.text();
        assert!(knows(&format!("?token={text}"), "") && knows(&format!("?drive=1&token={text}"), ""));
        assert!(knows("", &format!("Bearer {text}")));
        for (query, bearer) in [
            (String::new(), String::new()),
            ("?token=".into(), "Bearer ".into()),
            (format!("?token={}", &text[1..]), String::new()),
            (format!("?token={text}0"), String::new()),
            (String::new(), text.to_owned()),
            (format!("?xtoken={text}"), format!("Basic {text}")),
        ] {
            assert!(!knows(&query, &bearer), "{query} {bearer}");
        }
    }
}
