//! The JSON Schema of des.json, as an independent validator reads it.

use crate::common::python::Python;

/// Prints for each line, a JSON text, whether it is valid.
const VALIDATOR: &str = r#"
import json, sys
from jsonschema import Draft202012Validator
schema = json.loads(sys.argv[1])
Draft202012Validator.check_schema(schema)
validator = Draft202012Validator(schema)
for line in sys.stdin:
    print("valid" if validator.is_valid(json.loads(line)) else "not valid", flush=True)
"#;

/// Files as users write them, and as descan creates them.
const GOOD: [&str; 8] = [
    r#"{"devices":[{"name":"FEED","address":12,"static":true,"services":[{"name":"DES","version":"1.0"},{"name":"AUGER","version":"2.1"}]}]}"#,
    r#"[{"name":"FEED"},{"name":"SENS","address":127,"bus":"can0","uid":"BOILER01"}]"#,
    r#"{"devices":[]}"#,
    "{}",
    r#"{"devices":null,"note":"none yet"}"#,
    r#"[{"name":"FEED","services":{"DES":"1.0","AUGER":null},"color":"red"}]"#,
    r#"[{"name":"\\xff","name_hex":"FF","address":null,"static":null}]"#,
    r#"[{"name":"F","services":[{"name":"DES","version":"1.0","extra":["x"]}]}]"#,
];

/// Files in which descan reports a finding.
const BAD: [&str; 12] = [
    r#"{"devices":{"name":"FEED"}}"#,
    r#"[{"address":12}]"#,
    r#"[{"name":"FEED","address":0}]"#,
    r#"[{"name":"FEED","address":128}]"#,
    r#"[{"name":"FEED","address":"12"}]"#,
    r#"[{"name":"FEED","static":"yes"}]"#,
    r#"[{"name":"FEED","static":true}]"#,
    r#"[{"name":"FEED","static":true,"address":null}]"#,
    r#"[{"name":"FEED","name_hex":"F"}]"#,
    r#"[{"name":"FEED","services":"DES"}]"#,
    r#"["FEED"]"#,
    r#"{"foo":1}"#,
];

#[test]
fn schema_and_descan_find_the_same_faults() {
    for text in GOOD {
        let document = descan::document::Document::parse(text.as_bytes()).unwrap();
        assert_eq!(document.findings(), [], "{text}");
    }
    for text in BAD {
        let document = descan::document::Document::parse(text.as_bytes()).unwrap();
        assert_ne!(document.findings(), [], "{text}");
    }
    let Some(python) = Python::with(&["jsonschema==4.23.0"]) else { return };
    let mut validator = python.start(VALIDATOR, &[descan::document::SCHEMA]);
    let mut verdict = |text: &str| {
        validator.write_line(text);
        validator.read_line()
    };
    for text in GOOD {
        assert_eq!(verdict(text), "valid", "{text}");
    }
    for text in BAD {
        assert_eq!(verdict(text), "not valid", "{text}");
    }
}
