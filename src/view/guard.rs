//! Access control: only the holder of the printed address may connect.
//!
//! Every user of a shared machine can reach its loopback ports, and any page of any site can send requests there. A
//! request therefore needs the token of the address, exchanged for a cookie that other sites cannot use; its `Host`
//! must be this machine's own name (against names rebound by DNS); and a WebSocket's `Origin` must be that same host.

use std::net::{IpAddr, Ipv4Addr, Ipv6Addr};

/// Checks of a request.
#[derive(Clone, Debug)]
pub struct Guard {
    token: String,
    port: u16,
    /// The bound address, if it is not the usual one.
    host: Option<String>,
}

/// Result of the checks.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Verdict {
    /// Serve it.
    Pass,
    /// Accept it and set the cookie: its address contains the token.
    Enter,
    /// Refuse it with this sentence.
    Refuse(&'static str),
}

/// The parts of a request that the guard checks.
#[derive(Clone, Copy, Debug, Default)]
pub struct Asked<'a> {
    /// Query of the address, without `?`.
    pub query: &'a str,
    pub host: &'a str,
    pub origin: Option<&'a str>,
    pub cookie: &'a str,
    /// True for a WebSocket.
    pub socket: bool,
}

impl Guard {
    /// A guard with a random token of 128 bits, for a server bound to this address.
    ///
    /// # Errors
    /// The system has no random numbers.
    pub fn new(bound: IpAddr, port: u16) -> std::io::Result<Self> {
        let mut bytes = [0; 16];
        getrandom::fill(&mut bytes).map_err(|e| std::io::Error::other(e.to_string()))?;
        let token = format!("{:032x}", u128::from_ne_bytes(bytes));
        let host = (bound != Ipv4Addr::LOCALHOST && bound != Ipv6Addr::LOCALHOST).then(|| bound.to_string());
        Ok(Self { token, port, host })
    }

    /// Path and query of the page for the holder of the token.
    pub fn entrance(&self) -> String {
        format!("/?token={}", self.token)
    }

    pub fn cookie(&self) -> String {
        format!("{}={}; Path=/; SameSite=Strict; HttpOnly", self.name(), self.token)
    }

    /// Cookies do not depend on the port, so each server uses its own name.
    fn name(&self) -> String {
        format!("qirf-vk-{}", self.port)
    }

    pub fn check(&self, asked: Asked<'_>) -> Verdict {
        if !self.own(asked.host) {
            return Verdict::Refuse("unknown host name; use the IP address that qirf-vk printed");
        }
        let own_page = |o: &str| o.strip_prefix("http://").is_some_and(|o| o.eq_ignore_ascii_case(asked.host));
        if asked.socket && !asked.origin.is_some_and(own_page) {
            return Verdict::Refuse("pages of other sites may not connect to this viewer");
        }
        let given = asked.query.split('&').find_map(|p| p.strip_prefix("token="));
        if given.is_some_and(|token| self.is_token(token)) {
            return Verdict::Enter;
        }
        let name = self.name();
        let kept = asked.cookie.split(';').find_map(|c| c.trim().strip_prefix(name.as_str())?.strip_prefix('='));
        if kept.is_some_and(|token| self.is_token(token)) {
            return Verdict::Pass;
        }
        Verdict::Refuse("the token is missing or wrong; use the whole address that qirf-vk printed")
    }

    /// Whether a `Host` is this machine: a loopback name, at any port, since a tunnel may change it; or the bound
    /// address.
    fn own(&self, host: &str) -> bool {
        let name = match host.rsplit_once(':') {
            Some((name, port)) if port.parse::<u16>().is_ok() => name,
            _ => host,
        };
        let name = name.to_ascii_lowercase();
        ["127.0.0.1", "localhost", "[::1]"].contains(&name.as_str())
            || self.host.as_ref().is_some_and(|bound| match bound.as_str() {
                // Bound to every address: any numeric address is this machine's, and no name can be rebound to it.
                "0.0.0.0" | "::" => name.trim_matches(['[', ']']).parse::<IpAddr>().is_ok(),
                own => name.trim_matches(['[', ']']) == own,
            })
    }

    /// Compares in a time that does not depend on the position of a difference.
    fn is_token(&self, given: &str) -> bool {
        given.len() == self.token.len() && given.bytes().zip(self.token.bytes()).fold(0, |d, (a, b)| d | (a ^ b)) == 0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const HERE: IpAddr = IpAddr::V4(std::net::Ipv4Addr::LOCALHOST);

    #[test]
    fn only_the_holder_of_the_token_passes() {
        let guard = Guard::new(HERE, 4711).unwrap();
        let query = guard.entrance().split_once('?').unwrap().1.to_owned();
        let cookie = guard.cookie().split(';').next().unwrap().to_owned();
        let host = "127.0.0.1:4711";
        let asked = Asked { host, ..Asked::default() };
        assert_eq!(guard.check(Asked { query: &query, ..asked }), Verdict::Enter);
        assert_eq!(guard.check(Asked { cookie: &cookie, ..asked }), Verdict::Pass);
        assert_eq!(guard.check(Asked { cookie: &format!("a=b; {cookie}; c=d"), ..asked }), Verdict::Pass);
        let socket = Asked { cookie: &cookie, origin: Some("http://127.0.0.1:4711"), socket: true, ..asked };
        assert_eq!(guard.check(socket), Verdict::Pass);
        // Through a tunnel, the browser sees another port.
        for host in ["localhost:9000", "LOCALHOST:9000"] {
            assert_eq!(guard.check(Asked { host, cookie: &cookie, ..asked }), Verdict::Pass);
            assert_eq!(guard.check(Asked { host, origin: Some("http://localhost:9000"), ..socket }), Verdict::Pass);
        }

        let other = Guard::new(HERE, 4711).unwrap().cookie();
        for refused in [
            asked,
            Asked { query: "token=", ..asked },
            Asked { query: "token=00000000000000000000000000000000", ..asked },
            Asked { cookie: &other, ..asked },
            Asked { host: "", cookie: &cookie, ..asked },
            Asked { host: "127.evil.example:4711", cookie: &cookie, ..asked },
            Asked { host: "127.0.0.1.evil.example", cookie: &cookie, ..asked },
            Asked { host: "192.168.0.7:4711", cookie: &cookie, ..asked },
            Asked { origin: None, ..socket },
            Asked { origin: Some("http://evil.example"), ..socket },
            Asked { origin: Some("http://127.0.0.1:4711.evil.example"), ..socket },
            Asked { origin: Some("https://127.0.0.1:4711"), ..socket },
        ] {
            assert!(matches!(guard.check(refused), Verdict::Refuse(_)), "{refused:?}");
        }
    }

    #[test]
    fn a_server_open_to_the_network_is_reached_by_its_numbers() {
        let guard = Guard::new("0.0.0.0".parse().unwrap(), 80).unwrap();
        let cookie = guard.cookie();
        let check = |host| guard.check(Asked { host, cookie: cookie.split(';').next().unwrap(), ..Asked::default() });
        assert_eq!(check("10.0.0.5:80"), Verdict::Pass);
        assert_eq!(check("localhost:80"), Verdict::Pass);
        assert!(matches!(check("evil.example:80"), Verdict::Refuse(_)));
    }
}
