//! Documents that repeat declarations in the code are what `dpges` prints. `DPGES_WRITE_DOCUMENTS=1 cargo test -p
//! dpges --test documents` writes them again.

use std::path::Path;

use assert_cmd::Command;

const WRITE: &str = "DPGES_WRITE_DOCUMENTS";

/// Document, command whose output it contains.
const GENERATED: [(&str, &[&str]); 4] = [
    ("configs/default.toml", &["config"]),
    ("docs/reference/configuration.md", &["config", "--markdown"]),
    ("docs/reference/variants.md", &["ablate", "--list"]),
    ("docs/reference/variants.md", &["compare", "--list"]),
];

/// `document` with its generated part replaced: in Markdown what lies between comments that name the command, elsewhere
/// all of it.
fn renewed(document: &str, arguments: &[&str], printed: &str) -> String {
    let (begin, end) = (format!("<!-- dpges {} -->\n\n", arguments.join(" ")), "\n<!-- end -->\n");
    let Some((before, rest)) = document.split_once(&begin) else { return printed.to_owned() };
    let (_, after) = rest.split_once(end).expect("the generated part ends");
    format!("{before}{begin}{printed}{end}{after}")
}

#[test]
fn documents_are_what_the_program_prints() {
    let library = Path::new(env!("CARGO_MANIFEST_DIR")).parent().expect("a folder in the library's");
    for (name, arguments) in GENERATED {
        let path = library.join(name);
        let committed = std::fs::read_to_string(&path).unwrap();
        let output = Command::cargo_bin("dpges").unwrap().args(arguments).output().unwrap();
        let printed = String::from_utf8(output.stdout).unwrap();
        assert!(output.status.success() && !printed.is_empty(), "{}", String::from_utf8_lossy(&output.stderr));
        let expected = renewed(&committed, arguments, &printed);
        if std::env::var_os(WRITE).is_some() {
            std::fs::write(&path, &expected).unwrap();
        } else if committed != expected {
            panic!(
                "{name} differs from the output of `dpges {}`: write it again with \
                 `{WRITE}=1 cargo test -p dpges --test documents`",
                arguments.join(" ")
            );
        }
    }
}
