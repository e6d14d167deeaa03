//! The OpenAPI 3.1 document, made from the table of routes and the schemas of the documents.

mod problem;
mod schemas;

use serde_json::{Map, Value, json};

use super::routes::{Operation, table};

/// The document.
pub fn document() -> Value {
    let mut paths = Map::new();
    for route in table() {
        // A parameter that takes the rest of the path is written as any other.
        let path = route.path.replace("{*", "{");
        let methods: Map<String, Value> =
            route.operations.iter().map(|one| (one.method.to_owned(), operation(one))).collect();
        paths.insert(path, Value::Object(methods));
    }
    json!({
        "openapi": "3.1.0",
        "info": {
            "title": "Quadrille",
            "version": env!("CARGO_PKG_VERSION"),
            "description": "Plans for robot arms that work together: POST a workcell with two arrangements of its \
                            objects and read back a stream of ever better plans, each accepted by the judge.",
            "license": { "name": "Apache-2.0", "identifier": "Apache-2.0" },
        },
        "servers": [{ "url": "/" }],
        "paths": paths,
        "components": {
            "schemas": components(),
            "responses": {
                "Refused": {
                    "description": "Refused; the document says why.",
                    "headers": {
                        "Retry-After": {
                            "description": "When to try again (s), with 429 and 503.",
                            "schema": { "type": "integer" },
                        },
                    },
                    "content": { "application/problem+json": { "schema": reference("ProblemDocument") } },
                },
            },
        },
    })
}

/// The schemas of all documents by name, referring to each other as `#/components/schemas/NAME`.
fn components() -> Map<String, Value> {
    problem::schemas()
        .into_iter()
        .chain(schemas::schemas())
        .map(|(name, schema)| (name.to_owned(), schema))
        .collect()
}

/// JSON Schemas (2020-12) that stand alone, by file name: the documents of the format.
pub fn standalone() -> Vec<(String, Value)> {
    let roots = [
        ("problem", "Problem"),
        ("plan", "Plan"),
        ("event", "Event"),
        ("job", "Job"),
        ("error", "ProblemDocument"),
    ];
    let all = components();
    roots
        .iter()
        .map(|(file, root)| {
            let text = Value::Object(all.clone()).to_string().replace("#/components/schemas/", "#/$defs/");
            let mut definitions: Map<String, Value> = serde_json::from_str(&text).unwrap_or_default();
            let mut needed = vec![(*root).to_owned()];
            let mut reached = Vec::new();
            while let Some(name) = needed.pop() {
                if !reached.contains(&name) {
                    let own = definitions.get(&name).map(Value::to_string).unwrap_or_default();
                    needed.extend(
                        own.split("#/$defs/")
                            .skip(1)
                            .filter_map(|rest| rest.split('"').next())
                            .map(str::to_owned),
                    );
                    reached.push(name);
                }
            }
            definitions.retain(|name, _| reached.contains(name));
            let schema = json!({
                "$schema": "https://json-schema.org/draft/2020-12/schema",
                "title": root,
                "$ref": format!("#/$defs/{root}"),
                "$defs": definitions,
            });
            (format!("{file}.schema.json"), schema)
        })
        .collect()
}

fn reference(name: &str) -> Value {
    json!({ "$ref": format!("#/components/schemas/{name}") })
}

fn content(media: &[(&str, &str)]) -> Value {
    let entries =
        media.iter().map(|(media, schema)| ((*media).to_owned(), json!({ "schema": reference(schema) })));
    Value::Object(entries.collect())
}

fn operation(one: &Operation) -> Value {
    let parameters: Vec<Value> = one
        .parameters
        .iter()
        .map(|parameter| {
            let schema: Value = serde_json::from_str(parameter.schema).unwrap_or_default();
            json!({
                "in": parameter.place, "name": parameter.name, "required": parameter.required,
                "description": parameter.about, "schema": schema,
            })
        })
        .collect();
    let mut responses = Map::new();
    for reply in &one.replies {
        let mut described = json!({ "description": reply.about });
        if !reply.content.is_empty() {
            described["content"] = content(reply.content);
        }
        if reply.location {
            described["headers"] = json!({ "Location": { "schema": { "type": "string" } } });
        }
        responses.insert(reply.status.to_string(), described);
    }
    for status in one.refusals {
        responses.insert(status.to_string(), json!({ "$ref": "#/components/responses/Refused" }));
    }
    let mut described = json!({
        "operationId": one.id, "summary": one.summary, "parameters": parameters, "responses": responses,
    });
    if !one.body.is_empty() {
        described["requestBody"] = json!({ "required": true, "content": content(one.body) });
    }
    described
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::service::ApiError;

    #[test]
    fn every_reference_leads_somewhere() {
        let document = document();
        let text = document.to_string();
        for rest in text.split("\"#/").skip(1) {
            let pointer = format!("/{}", rest.split('"').next().unwrap());
            assert!(document.pointer(&pointer).is_some(), "{pointer}");
        }
        for (file, schema) in standalone() {
            for rest in schema.to_string().split("\"#/").skip(1) {
                let pointer = format!("/{}", rest.split('"').next().unwrap());
                assert!(schema.pointer(&pointer).is_some(), "{file}: {pointer}");
            }
        }
    }

    #[test]
    fn every_schema_of_a_parameter_is_json_and_ids_are_distinct() {
        let mut ids = Vec::new();
        for route in table() {
            for one in route.operations {
                ids.push(one.id);
                for parameter in one.parameters {
                    assert!(serde_json::from_str::<Value>(parameter.schema).is_ok(), "{}", parameter.name);
                }
                assert!(one.refusals.iter().all(|status| *status >= 400));
                // Bodies are read as what they say they are.
                assert!(one.body.is_empty() || one.refusals.contains(&415), "{}", one.id);
            }
        }
        let count = ids.len();
        ids.sort_unstable();
        ids.dedup();
        assert_eq!(ids.len(), count);
    }

    #[test]
    fn refusals_have_the_codes_that_the_schema_lists() {
        let schema = components();
        let codes = schema["ProblemDocument"]["properties"]["code"]["enum"].as_array().unwrap().clone();
        assert_eq!(codes, ApiError::CODES.map(Value::from));
    }
}
