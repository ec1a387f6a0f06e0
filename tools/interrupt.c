// Runs a command in a console of its own, and ends it as a user would: for tools/try-windows.
//   interrupt.exe c|break|close FILE COMMAND LINE
// Waits until FILE has contents, raises Ctrl-C, Ctrl-Break or the closing of the window, and ends with the command's exit code. Wine's
// console delivers Ctrl-C alone. The others get what Windows makes in each process of a console: a thread in kernelbase's CtrlRoutine.
#include <stdio.h>
#include <string.h>
#include <windows.h>

static int fail(const char *what) {
    fprintf(stderr, "interrupt: %s (error %lu)\n", what, GetLastError());
    return 1;
}

static BOOL WINAPI survive(DWORD event) {
    (void)event;
    return TRUE;
}

static BOOL has_contents(const char *path) {
    WIN32_FILE_ATTRIBUTE_DATA data;
    return GetFileAttributesExA(path, GetFileExInfoStandard, &data) && data.nFileSizeLow > 0;
}

int main(int count, char **words) {
    if (count < 4) return fail("usage: interrupt.exe c|break|close FILE COMMAND LINE");
    DWORD event = words[1][0] == 'b' ? CTRL_BREAK_EVENT : strcmp(words[1], "c") == 0 ? CTRL_C_EVENT : CTRL_CLOSE_EVENT;
    char line[4096] = "";
    for (int i = 3; i < count; i++) strcat(strcat(line, words[i]), " ");

    FreeConsole();
    if (!AllocConsole() || !SetConsoleCtrlHandler(survive, TRUE)) return fail("no console");
    STARTUPINFOA start = {.cb = sizeof start};
    PROCESS_INFORMATION child;
    if (!CreateProcessA(NULL, line, NULL, NULL, FALSE, 0, NULL, NULL, &start, &child)) return fail("the command did not start");
    while (!has_contents(words[2]))
        if (WaitForSingleObject(child.hProcess, 50) == WAIT_OBJECT_0) return fail("the command ended too early");

    HANDLE routine = NULL;
    if (event == CTRL_C_EVENT) {
        if (!GenerateConsoleCtrlEvent(event, 0)) return fail("no Ctrl-C");
    } else {
        LPTHREAD_START_ROUTINE start_at = (void *)GetProcAddress(GetModuleHandleA("kernelbase.dll"), "CtrlRoutine");
        routine = CreateRemoteThread(child.hProcess, NULL, 0, start_at, (void *)(size_t)event, 0, NULL);
        if (routine == NULL) return fail("no thread in the command");
    }
    if (WaitForSingleObject(child.hProcess, 60000) != WAIT_OBJECT_0) return fail("the command goes on a minute later");
    DWORD code, of_routine;
    GetExitCodeProcess(child.hProcess, &code);
    // Windows ends a program whose handler returns from the closing of its window: the thread has to end with the program.
    if (event == CTRL_CLOSE_EVENT && (!GetExitCodeThread(routine, &of_routine) || of_routine != code)) return fail("the handler returned before the command's end");
    return (int)code;
}
