//! Roles, and the table of what each route needs.

use std::fmt;

use axum::http::Method;
use skycell_protocol::read_json::{ReadJson, read_name};
use skycell_protocol::value_error::ValueError;

/// What the holder of a token may do. Each role may all that the ones before it may.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Role {
    /// Watch: the WebSocket, and reading what concerns the sky.
    View,
    /// Change the sky: scene, maps, presets, time.
    Steer,
    /// Everything: where the other viewers are, figures and metrics, older scenes.
    Admin,
}

impl Role {
    /// Every role by its name.
    pub const NAMES: [(&'static str, Self); 3] = [
        ("view", Self::View),
        ("steer", Self::Steer),
        ("admin", Self::Admin),
    ];

    /// Its name, as configurations and problems write it.
    pub fn name(self) -> &'static str {
        match self {
            Self::View => "view",
            Self::Steer => "steer",
            Self::Admin => "admin",
        }
    }

    /// The role of that name.
    pub fn of_name(name: &str) -> Option<Self> {
        Self::NAMES
            .iter()
            .find(|(known, _)| *known == name)
            .map(|(_, role)| *role)
    }
}

impl fmt::Display for Role {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

impl ReadJson for Role {
    fn read_json(value: &serde_json::Value, pointer: &str) -> Result<Self, ValueError> {
        read_name(value, pointer, &Self::NAMES)
    }
}

/// What a request needs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Rule {
    /// No token: there is nothing to see or to change yet.
    Anyone,
    /// A token of at least this role.
    Needs(Role),
}

/// Reading these needs the role *view*. Whatever ends with `/*` stands for all paths below it.
const VIEW: &[&str] = &[
    "/api/v1/docs",
    "/api/v1/openapi.json",
    "/api/v1/presets",
    "/api/v1/presets/*",
    "/api/v1/scene",
    "/api/v1/scene/events",
    "/api/v1/scene/maps/*",
    "/api/v1/scene/now",
    "/api/v1/scene/time",
    "/api/v1/snapshot",
    "/api/v1/views",
];

/// Changing these needs the role *steer*; reading the revisions, which are for whoever changes the sky, does too.
const STEER: &[(&Method, &str)] = &[
    (&Method::PATCH, "/api/v1/scene"),
    (&Method::PUT, "/api/v1/scene"),
    (&Method::PUT, "/api/v1/scene/maps/*"),
    (&Method::DELETE, "/api/v1/scene/maps/*"),
    (&Method::PUT, "/api/v1/scene/time"),
    (&Method::POST, "/api/v1/scene/preset"),
    (&Method::GET, "/api/v1/scene/revisions"),
    (&Method::GET, "/api/v1/scene/revisions/*"),
];

/// What a request needs, by its method and path. `is_page` says that the path is a file of the page, which anyone may
/// load: it is what asks for the token.
///
/// A path that no table names needs the role *admin*: a route that somebody adds is closed until it is named here.
pub fn rule_of(method: &Method, path: &str, is_page: bool) -> Rule {
    let reads = matches!(*method, Method::GET | Method::HEAD | Method::OPTIONS);
    match path {
        // The WebSocket has its token in its first message, where it is no part of an address.
        "/livez" | "/readyz" | "/ws" if reads => return Rule::Anyone,
        _ if reads && is_page => return Rule::Anyone,
        _ => {}
    }
    let steers = |(named, pattern): &(&Method, &str)| {
        (*named == method || (**named == Method::GET && reads)) && matches_path(pattern, path)
    };
    if reads && VIEW.iter().any(|pattern| matches_path(pattern, path)) {
        Rule::Needs(Role::View)
    } else if STEER.iter().any(steers) {
        Rule::Needs(Role::Steer)
    } else {
        Rule::Needs(Role::Admin)
    }
}

fn matches_path(pattern: &str, path: &str) -> bool {
    match pattern.strip_suffix('*') {
        Some(folder) => path
            .strip_prefix(folder)
            .is_some_and(|rest| !rest.is_empty()),
        None => path == pattern,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_route_needs_what_the_table_says() {
        use Rule::{Anyone, Needs};
        for (method, path, is_page, rule) in [
            (Method::GET, "/", true, Anyone),
            (Method::GET, "/main.js", true, Anyone),
            (Method::GET, "/livez", false, Anyone),
            (Method::HEAD, "/readyz", false, Anyone),
            (Method::GET, "/ws", false, Anyone),
            (Method::GET, "/api/v1/scene", false, Needs(Role::View)),
            (Method::HEAD, "/api/v1/scene", false, Needs(Role::View)),
            (
                Method::GET,
                "/api/v1/scene/maps/type",
                false,
                Needs(Role::View),
            ),
            (
                Method::GET,
                "/api/v1/presets/storm",
                false,
                Needs(Role::View),
            ),
            (Method::PATCH, "/api/v1/scene", false, Needs(Role::Steer)),
            (
                Method::DELETE,
                "/api/v1/scene/maps/type",
                false,
                Needs(Role::Steer),
            ),
            (
                Method::POST,
                "/api/v1/scene/preset",
                false,
                Needs(Role::Steer),
            ),
            (Method::PUT, "/api/v1/scene/time", false, Needs(Role::Steer)),
            (
                Method::POST,
                "/api/v1/scene/revert",
                false,
                Needs(Role::Admin),
            ),
            (Method::GET, "/api/v1/viewers", false, Needs(Role::Admin)),
            (Method::GET, "/api/v1/cells", false, Needs(Role::Admin)),
            (Method::GET, "/api/v1/stats", false, Needs(Role::Admin)),
            (Method::GET, "/metrics", false, Needs(Role::Admin)),
            // What is not named is closed, also beside what is.
            (Method::GET, "/api/v1/new", false, Needs(Role::Admin)),
            (Method::GET, "/debug", false, Needs(Role::Admin)),
            (Method::DELETE, "/", true, Needs(Role::Admin)),
            (Method::POST, "/livez", false, Needs(Role::Admin)),
            (Method::GET, "/api/v1/scene/", false, Needs(Role::Admin)),
            (
                Method::GET,
                "/api/v1/scene/maps/",
                false,
                Needs(Role::Admin),
            ),
            (Method::POST, "/api/v1/scene", false, Needs(Role::Admin)),
        ] {
            assert_eq!(rule_of(&method, path, is_page), rule, "{method} {path}");
        }
    }

    #[test]
    fn a_role_may_all_that_the_lesser_ones_may() {
        assert!(Role::View < Role::Steer && Role::Steer < Role::Admin);
        for (name, role) in Role::NAMES {
            assert_eq!((role.name(), Role::of_name(name)), (name, Some(role)));
        }
    }
}
