//! Parts of operations that many have.

use serde_json::{Map, Value, json};

use super::schemas::reference;

/// An operation of a path.
pub(super) struct Operation {
    members: Map<String, Value>,
    parameters: Vec<Value>,
    responses: Map<String, Value>,
}

impl Operation {
    /// An operation without answers: beside those that are added, every request may be refused at the gate, take too long,
    /// bring too much or meet a server that fails.
    pub(super) fn new(id: &str, tag: &str, summary: &str) -> Self {
        let members = json!({"operationId": id, "tags": [tag], "summary": summary});
        Self {
            members: members.as_object().cloned().unwrap_or_default(),
            parameters: Vec::new(),
            responses: Map::new(),
        }
        .problem(
            400,
            "The request cannot be read, or has a token in its address, where it does not belong.",
        )
        .problem(
            401,
            "The server needs a token, and the request has none or one that is not known.",
        )
        .problem(
            403,
            "A page of another site asks, or the token's role is too small (`role_needed`).",
        )
        .problem(421, "The request's `Host` is no name of this server.")
        .problem(
            429,
            "Too many requests of this address: `Retry-After` tells when to try again.",
        )
        .problem(408, "The request took too long.")
        .problem(413, "The body is too long.")
        .problem(500, "The server failed; its log tells why.")
    }

    pub(super) fn description(mut self, text: &str) -> Self {
        self.members.insert("description".into(), text.into());
        self
    }

    pub(super) fn query(self, name: &str, about: &str, schema: Value) -> Self {
        self.parameter("query", name, about, false, schema)
    }

    pub(super) fn path(self, name: &str, about: &str, schema: Value) -> Self {
        self.parameter("path", name, about, true, schema)
    }

    pub(super) fn header(self, name: &str, about: &str, schema: Value) -> Self {
        self.parameter("header", name, about, false, schema)
    }

    fn parameter(
        mut self,
        place: &str,
        name: &str,
        about: &str,
        required: bool,
        schema: Value,
    ) -> Self {
        self.parameters.push(json!({
            "in": place, "name": name, "description": about, "required": required, "schema": schema,
        }));
        self
    }

    /// A change that needs to know what it changes.
    pub(super) fn with_precondition(mut self) -> Self {
        self.parameters.push(json!({
            "in": "header",
            "name": "If-Match",
            "description": "The `ETag` of the scene that is meant, or `*` for whatever it is.",
            "required": true,
            "schema": {"type": "string"},
            "example": "*",
        }));
        self.problem(412, "The scene has another revision: `ETag` tells which.")
            .problem(428, "There is no `If-Match`.")
    }

    /// An answer that a client may have already.
    pub(super) fn with_known(self) -> Self {
        let mut operation = self.header(
            "If-None-Match",
            "An `ETag` that the client has.",
            json!({"type": "string"}),
        );
        operation.responses.insert(
            "304".into(),
            json!({"description": "The client has it.", "headers": {"ETag": etag_header()}}),
        );
        operation
    }

    /// What the body may hold, by content type.
    pub(super) fn body(mut self, contents: Value) -> Self {
        self.members.insert(
            "requestBody".into(),
            json!({"required": true, "content": contents}),
        );
        self.problem(415, "The body has another content type.")
    }

    /// As [`Self::body`], of a body that may be left out.
    pub(super) fn optional_body(self, contents: Value) -> Self {
        let mut operation = self.body(contents);
        if let Some(body) = operation.members.get_mut("requestBody") {
            body["required"] = false.into();
        }
        operation
    }

    /// The answer where all is well.
    pub(super) fn answer(mut self, about: &str, contents: Value, with_etag: bool) -> Self {
        let mut response = json!({"description": about, "content": contents});
        if with_etag {
            response["headers"] = json!({"ETag": etag_header()});
        }
        self.responses.insert("200".into(), response);
        self
    }

    /// As [`Self::answer`], of a schema, in JSON.
    pub(super) fn answer_json(self, about: &str, schema: Value, with_etag: bool) -> Self {
        self.answer(
            about,
            json!({"application/json": {"schema": schema}}),
            with_etag,
        )
    }

    /// An answer that is no success.
    pub(super) fn problem(mut self, status: u16, about: &str) -> Self {
        self.responses.insert(
            status.to_string(),
            json!({
                "description": about,
                "content": {"application/problem+json": {"schema": reference("Problem")}},
            }),
        );
        self
    }

    /// As it stands in the document.
    pub(super) fn value(mut self) -> Value {
        if !self.parameters.is_empty() {
            self.members
                .insert("parameters".into(), self.parameters.into());
        }
        self.members
            .insert("responses".into(), self.responses.into());
        self.members.into()
    }
}

fn etag_header() -> Value {
    json!({
        "description": "Names this state: for `If-Match` and `If-None-Match`.",
        "schema": {"type": "string"},
    })
}
