//! `qirf-vk completions SHELL`.

use super::console::Console;
use crate::job::Error;

const EXAMPLES: &str = r"Examples:
  mkdir -p ~/.local/share/bash-completion/completions
  qirf-vk completions bash > ~/.local/share/bash-completion/completions/qirf-vk
  mkdir -p ~/.zfunc
  qirf-vk completions zsh > ~/.zfunc/_qirf-vk
  mkdir -p ~/.config/fish/completions
  qirf-vk completions fish > ~/.config/fish/completions/qirf-vk.fish
  qirf-vk completions powershell > qirf-vk.ps1

For zsh, ~/.zshrc needs before compinit: fpath+=(~/.zfunc)

For PowerShell, $PROFILE needs: . C:\path\to\qirf-vk.ps1";

#[derive(Debug, clap::Args)]
#[command(after_help = EXAMPLES)]
pub(super) struct Arguments {
    /// The shell
    shell: clap_complete::Shell,
}

impl Arguments {
    pub fn run(&self, console: &Console) -> Result<(), Error> {
        let mut text = Vec::new();
        clap_complete::generate(self.shell, &mut super::command(), "qirf-vk", &mut text);
        console.print(String::from_utf8_lossy(&text).trim_end())
    }
}
