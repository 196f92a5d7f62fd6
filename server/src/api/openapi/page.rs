//! The document as a page: what is asked where, what comes back, and every key of a scene.

use maud::{DOCTYPE, Markup, html};
use serde_json::{Map, Value};
use skycell_protocol::schema::COMPONENTS;

const METHODS: [&str; 5] = ["get", "put", "post", "patch", "delete"];

/// The page of a document.
pub(super) fn of(document: &Value) -> String {
    let title = text(document, "/info/title");
    html! {
        (DOCTYPE)
        html lang="en" {
            head {
                meta charset="utf-8";
                meta name="viewport" content="width=device-width, initial-scale=1";
                title { (title) " HTTP API" }
                link rel="stylesheet" href="/docs.css";
            }
            body {
                main {
                    h1 { (title) " HTTP API" }
                    p { (ticked(text(document, "/info/description"))) }
                    p {
                        "OpenAPI 3.1: " a href="/api/v1/openapi.json" { "openapi.json" } ". "
                        a href="/" { "The sky." }
                    }
                    @for tag in items(document, "/tags") { (section(document, tag)) }
                    h2 id="schemas" { "Schemas" }
                    @for (name, schema) in members(document, "/components/schemas") { (schema_section(name, schema)) }
                }
            }
        }
    }
    .into_string()
}

fn section(document: &Value, tag: &Value) -> Markup {
    let name = text(tag, "/name");
    html! {
        h2 id=(name) { (name) }
        p { (ticked(text(tag, "/description"))) }
        @for (path, item) in members(document, "/paths") {
            @for method in METHODS {
                @if let Some(operation) = item.get(method).filter(|operation| text(operation, "/tags/0") == name) {
                    (operation_section(method, path, operation))
                }
            }
        }
    }
}

fn operation_section(method: &str, path: &str, operation: &Value) -> Markup {
    let id = text(operation, "/operationId");
    html! {
        section id=(id) {
            h3 { code { (method.to_uppercase()) " " (path) } }
            p { (ticked(text(operation, "/summary"))) " " (ticked(text(operation, "/description"))) }
            @if operation.get("parameters").is_some() {
                table {
                    thead { tr { th { "Parameter" } th { "In" } th { "Value" } th { "Meaning" } } }
                    tbody {
                        @for parameter in items(operation, "/parameters") {
                            tr {
                                td {
                                    code { (text(parameter, "/name")) }
                                    @if parameter["required"] == true { " (required)" }
                                }
                                td { (text(parameter, "/in")) }
                                td { (kind(&parameter["schema"])) }
                                td { (ticked(text(parameter, "/description"))) }
                            }
                        }
                    }
                }
            }
            @for (content, body) in members(operation, "/requestBody/content") {
                p { "Body: " code { (content) } ", " (kind(&body["schema"])) }
                @for (_, example) in members(body, "/examples") {
                    pre { code { (example["value"].to_string()) } }
                }
            }
            table {
                thead { tr { th { "Status" } th { "Answer" } th { "Content" } } }
                tbody {
                    @for (status, response) in members(operation, "/responses") {
                        tr {
                            td { (status) }
                            td { (ticked(text(response, "/description"))) }
                            td {
                                @for (content, body) in members(response, "/content") {
                                    div { code { (content) } " " (kind(&body["schema"])) }
                                }
                            }
                        }
                    }
                }
            }
        }
    }
}

fn schema_section(name: &str, schema: &Value) -> Markup {
    html! {
        section id=(format!("schema-{name}")) {
            h3 { (name) }
            p { (ticked(text(schema, "/description"))) }
            (schema_table(schema))
            @for choice in items(schema, "/oneOf") {
                @if choice.get("properties").is_some() {
                    p { (ticked(text(choice, "/description"))) }
                    (schema_table(choice))
                } @else {
                    p { (kind(choice)) }
                }
            }
        }
    }
}

fn schema_table(schema: &Value) -> Markup {
    let properties = members(schema, "/properties");
    let mut order: Vec<&str> = items(schema, "/x-order")
        .filter_map(Value::as_str)
        .collect();
    order.extend(
        properties
            .clone()
            .map(|(key, _)| key.as_str())
            .filter(|key| !items(schema, "/x-order").any(|known| known == *key)),
    );
    html! {
        @if schema.get("properties").is_some() {
            table {
                thead { tr { th { "Key" } th { "Value" } th { "Default" } th { "Meaning" } } }
                tbody {
                    @for key in order {
                        @let property = &schema["properties"][key];
                        tr {
                            td { code { (key) } }
                            td { (kind(property)) }
                            td { @if let Some(default) = property.get("default") { code { (short(default)) } } }
                            td { (ticked(text(property, "/description"))) }
                        }
                    }
                }
            }
        } @else if schema.get("oneOf").is_none() {
            p { (kind(schema)) }
        }
    }
}

/// What may stand there, in a few words.
fn kind(schema: &Value) -> Markup {
    if let Some(name) = schema
        .get("$ref")
        .and_then(Value::as_str)
        .and_then(|at| at.strip_prefix(COMPONENTS))
    {
        return html! { a href=(format!("#schema-{name}")) { (name) } };
    }
    if let Some(constant) = schema.get("const") {
        return html! { code { (constant.to_string()) } };
    }
    if let Some(names) = schema.get("enum").and_then(Value::as_array) {
        return html! { @for (index, name) in names.iter().enumerate() { @if index > 0 { ", " } code { (name.to_string()) } } };
    }
    for key in ["oneOf", "anyOf"] {
        if let Some(choices) = schema.get(key).and_then(Value::as_array) {
            return html! { @for (index, choice) in choices.iter().enumerate() { @if index > 0 { " or " } (kind(choice)) } };
        }
    }
    let name = match &schema["type"] {
        Value::Array(kinds) => kinds
            .iter()
            .filter_map(Value::as_str)
            .collect::<Vec<_>>()
            .join(" or "),
        other => other.as_str().unwrap_or("anything").to_owned(),
    };
    let range = match (schema.get("minimum"), schema.get("maximum")) {
        (Some(low), Some(high)) => format!(", {low} to {high}"),
        _ => String::new(),
    };
    let unit = schema
        .get("x-unit")
        .and_then(Value::as_str)
        .map(|unit| format!(" {unit}"));
    html! {
        (name) (range) (unit.unwrap_or_default())
        @if let Some(items) = schema.get("items").filter(|items| items.is_object()) { " of " (kind(items)) }
    }
}

/// Words between grave accents are code.
fn ticked(text: &str) -> Markup {
    html! {
        @for (index, part) in text.split('`').enumerate() {
            @if index % 2 == 1 { code { (part) } } @else { (part) }
        }
    }
}

/// A default, cut where it is long.
fn short(value: &Value) -> String {
    let text = value.to_string();
    if text.chars().count() <= 40 {
        return text;
    }
    let mut cut: String = text.chars().take(39).collect();
    cut.push('…');
    cut
}

fn text<'a>(value: &'a Value, pointer: &str) -> &'a str {
    value
        .pointer(pointer)
        .and_then(Value::as_str)
        .unwrap_or_default()
}

fn items<'a>(value: &'a Value, pointer: &str) -> impl Iterator<Item = &'a Value> + Clone {
    value
        .pointer(pointer)
        .and_then(Value::as_array)
        .into_iter()
        .flatten()
}

fn members<'a>(
    value: &'a Value,
    pointer: &str,
) -> impl Iterator<Item = (&'a String, &'a Value)> + Clone {
    value
        .pointer(pointer)
        .and_then(Value::as_object)
        .into_iter()
        .flat_map(Map::iter)
}
