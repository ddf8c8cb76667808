//! The keys: what each does, and the list that the help shows.

use egui::{Align2, Context, Event, Grid, InputState, Key, Modifiers, RichText, Window};

use super::editing::{Edit, Tool};
use crate::Display;

/// The commands of keys, besides moving.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Command {
    Display(Display),
    Mode,
    Home,
    LevelUp,
    PreviousView,
    NextView,
    Compare,
    Measure,
    Edit(Edit),
    Screenshot,
    AddToPath,
    PlayPath,
    Open,
    Panel,
    Help,
    Fullscreen,
    Escape,
}

const DISPLAY_KEYS: [Key; 8] = [Key::Num1, Key::Num2, Key::Num3, Key::Num4, Key::Num5, Key::Num6, Key::Num7, Key::Num8];

const KEYS: [(Key, Command); 22] = [
    (Key::F, Command::Mode),
    (Key::Home, Command::Home),
    (Key::U, Command::LevelUp),
    (Key::PageUp, Command::PreviousView),
    (Key::PageDown, Command::NextView),
    (Key::C, Command::Compare),
    (Key::M, Command::Measure),
    (Key::P, Command::Screenshot),
    (Key::K, Command::AddToPath),
    (Key::Space, Command::PlayPath),
    (Key::O, Command::Open),
    (Key::N, Command::Panel),
    (Key::F1, Command::Help),
    (Key::F11, Command::Fullscreen),
    (Key::Escape, Command::Escape),
    (Key::R, Command::Edit(Edit::Tool(Tool::Box))),
    (Key::B, Command::Edit(Edit::Tool(Tool::Brush))),
    (Key::OpenBracket, Command::Edit(Edit::SmallerBrush)),
    (Key::CloseBracket, Command::Edit(Edit::LargerBrush)),
    (Key::I, Command::Edit(Edit::Invert)),
    (Key::Delete, Command::Edit(Edit::Delete)),
    (Key::Backspace, Command::Edit(Edit::Delete)),
];

/// With ctrl, and whether with shift.
const CTRL_KEYS: [(Key, bool, Edit); 6] = [
    (Key::A, false, Edit::SelectAll),
    (Key::D, false, Edit::SelectNothing),
    (Key::Z, false, Edit::Undo),
    (Key::Z, true, Edit::Redo),
    (Key::Y, false, Edit::Redo),
    (Key::S, false, Edit::Save),
];

/// Mouse and key bindings, for the help.
const HELP: [(&str, &str); 31] = [
    ("drag", "turn about the focus (orbit) or look around (fly)"),
    ("right drag, shift + drag", "pan"),
    ("ctrl + drag", "look around"),
    ("wheel, pinch", "nearer, farther"),
    ("two fingers on a touchpad", "turn; with shift: pan"),
    ("double click", "focus on that point"),
    ("W A S D, Q E", "fly; Q down, E up"),
    ("arrows", "turn"),
    ("shift", "four times as fast"),
    ("F", "dragging turns about the focus or about the eye"),
    ("Home", "back to the first view"),
    ("U", "what is up in this view is up in the world"),
    ("page up, page down", "fly to the camera before, the next one"),
    ("1 … 8", "image, surfels, Gaussians, transmittance, depth, normals, layers, overdraw"),
    ("C", "compare with the photograph: side by side, wipe, error, off"),
    ("M", "measure: click two points"),
    ("R, B", "select by a box, by a brush ([ ] its size): drag; shift adds, ctrl subtracts; right drag turns"),
    ("ctrl + A, ctrl + D, I", "select all, nothing, the others"),
    ("delete", "delete what is selected"),
    ("ctrl + Z, ctrl + shift + Z", "undo, redo"),
    ("ctrl + S", "save the edited scene"),
    ("P", "screenshot"),
    ("K", "add this view to the camera path"),
    ("space", "play or stop the path"),
    ("O", "open a scene"),
    ("N", "show or hide the panel"),
    ("F11", "full screen"),
    ("F1", "this list"),
    ("Esc", "close this list; end measuring, selecting and playing"),
    ("drop a file", "open a scene file or the folder of a run"),
    ("click, double click on a camera", "fly there, be there"),
];

/// The commands of the keys that were pressed, each with its own modifiers: of a slow frame they are up again at its end.
pub fn commands(input: &InputState) -> Vec<Command> {
    let command = |event: &Event| match *event {
        Event::Key { key, pressed: true, modifiers, .. } => command(key, modifiers),
        _ => None,
    };
    input.events.iter().filter_map(command).collect()
}

fn command(key: Key, modifiers: Modifiers) -> Option<Command> {
    if modifiers.alt {
        return None;
    }
    if modifiers.command {
        let is_this = |&(known, shift, _): &(Key, bool, Edit)| (known, shift) == (key, modifiers.shift);
        return CTRL_KEYS.into_iter().find(is_this).map(|(_, _, edit)| Command::Edit(edit));
    }
    let displays = DISPLAY_KEYS.into_iter().zip(Display::ALL.map(Command::Display));
    displays.chain(KEYS).find(|(known, _)| *known == key).map(|(_, command)| command)
}

/// Shows the list of keys over the picture; `open` becomes false when it is closed.
pub fn show_help(context: &Context, open: &mut bool) {
    let window = Window::new("Mouse and keys").open(open).collapsible(false).resizable(false);
    window.anchor(Align2::CENTER_CENTER, [0.0, 0.0]).show(context, |ui| {
        Grid::new("keys").num_columns(2).striped(true).spacing([24.0, 4.0]).show(ui, |ui| {
            for (keys, meaning) in HELP {
                ui.label(RichText::new(keys).strong());
                ui.label(meaning);
                ui.end_row();
            }
        });
    });
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn keys_have_the_modifiers_that_they_were_pressed_with() {
        let of = |key: Key, modifiers: Modifiers| {
            let mut input = InputState::default();
            input.events.push(Event::Key { key, physical_key: None, pressed: true, repeat: false, modifiers });
            assert_eq!(input.modifiers, Modifiers::NONE, "they are up again");
            commands(&input)
        };
        assert_eq!(of(Key::Z, Modifiers::COMMAND), [Command::Edit(Edit::Undo)]);
        assert_eq!(of(Key::Z, Modifiers::COMMAND | Modifiers::SHIFT), [Command::Edit(Edit::Redo)]);
        assert_eq!(of(Key::A, Modifiers::COMMAND), [Command::Edit(Edit::SelectAll)]);
        assert_eq!(of(Key::P, Modifiers::NONE), [Command::Screenshot]);
        assert!(of(Key::Z, Modifiers::NONE).is_empty() && of(Key::P, Modifiers::ALT).is_empty());
    }
}
